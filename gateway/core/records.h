/* Records of the core: one line per field, with unit and meaning.
 *
 * The compiler, cffi and NumPy (dbc/records.py) all read this file, so a layout stands here once.
 * Only `#define` of a number, `enum` and `struct` are allowed: cffi reads nothing else. */
#ifndef TRACTION_RECORDS_H
#define TRACTION_RECORDS_H

#include <stdint.h>

#define E2E_WINDOW    5 /* receiver cycles that the state machine looks back */
#define E2E_MAX_DELTA 3 /* counter steps between two accepted frames: two may be lost in a row */

/* Protection of a message; the numbers are those of the DBC attribute `E2EProfile`. */
enum e2e_profile {
    E2E_PROFILE_NONE = 0,
    E2E_PROFILE_02 = 1, /* CRC-8 0x2F, counter of 4 bits; classic frames */
    E2E_PROFILE_05 = 2, /* CRC-16 CCITT, counter of 8 bits; CAN FD frames */
};

/* Result of one receiver cycle (AUTOSAR: E2E_PCheckStatusType). */
enum e2e_check_status {
    E2E_P_OK = 0,
    E2E_P_OK_SOME_LOST = 1,   /* accepted; the counter proves up to E2E_MAX_DELTA - 1 frames lost */
    E2E_P_ERROR = 2,          /* wrong checksum, or shorter than the header */
    E2E_P_REPEATED = 3,       /* the counter of the frame before */
    E2E_P_WRONG_SEQUENCE = 4, /* the counter jumped */
    E2E_P_NO_NEW_DATA = 5,    /* nothing received in this cycle */
};

/* State of the receiver (AUTOSAR: E2E_SMStateType). */
enum e2e_sm_state {
    E2E_SM_NO_DATA = 0,
    E2E_SM_INIT = 1,
    E2E_SM_VALID = 2,
    E2E_SM_INVALID = 3,
};

/* How one message is protected; constant. */
struct e2e_config {
    uint16_t length;     /* bytes of a frame */
    uint8_t profile;     /* enum e2e_profile */
    uint8_t fd;          /* FD flag that its frames carry (dbc.frame.FD), or 0 */
    uint8_t data_id[16]; /* profile 02: by counter; profile 05: low byte, high byte */
};

/* What the receiver of one message remembers; `e2e_reset` makes one that has received nothing. */
struct e2e_state {
    int16_t counter; /* of the last frame with a good checksum; -1: none yet */
    uint16_t step;   /* counter steps to that frame from the one before: 1 to a whole turn */
    uint8_t missed;  /* frames that the last accepted frame proves lost */
    uint8_t state;   /* enum e2e_sm_state */
    uint8_t window[E2E_WINDOW]; /* status of the last cycles, a ring (enum e2e_check_status) */
    uint8_t next;               /* index in `window` of the oldest */
};

/* Flags (gateway/core/flags.c), and the numbers that are published with them. */

#define FLAG_KINDS 5         /* of a drive: enum flag_kind */
#define NO_TIME    INT64_MIN /* in place of a time or an age that there is not */

enum flag_kind {
    FLAG_ADHESION = 0,
    FLAG_THERMAL = 1,
    FLAG_COMM = 2,
    FLAG_ESTIMATOR = 3,
    FLAG_SENSOR = 4
};

/* State of a flag as it is sent, and evidence for it. */
enum flag_state {
    FLAG_UNKNOWN = 0,
    FLAG_GOOD = 1,
    FLAG_BAD = 2,
    FLAG_UNCHANGED =
        3, /* evidence only: the evidence of before stands, and no flag changes by it */
};

/* Why something is unknown; the numbers are those of the DBC. Priorities: `reason_rank`. */
enum reason {
    REASON_NONE = 0,
    REASON_STARTING = 1,
    REASON_STALE = 2,
    REASON_CORRUPTED = 3,
    REASON_SEQUENCE = 4,
    REASON_RANGE = 5,
    REASON_NOT_AVAILABLE = 6,
    REASON_DIVERGED = 7,
    REASON_TOO_FEW_DRIVES = 8,
    REASON_OVERRUN = 9,
    REASON_INTRUDER = 10,
    REASON_CONFIG = 11,
};

/* State of the filter of a drive. */
enum filter_health {
    HEALTH_UNKNOWN = 0,
    HEALTH_CONVERGING = 1,
    HEALTH_TRACKING = 2,
    HEALTH_PREDICTING = 3,
    HEALTH_DIVERGED = 4,
    HEALTH_INPUT_INVALID = 5,
};

/* Kind of a thermal fault or of a fault of a sensor. */
enum fault_class {
    FAULT_UNKNOWN = 0,
    FAULT_NONE = 1,
    FAULT_OVERHEATING = 2,
    FAULT_COOLING_LOSS = 3,
    FAULT_BEARING = 4,
    FAULT_SENSOR_BIAS = 5,
    FAULT_SENSOR_STUCK = 6,
    FAULT_SENSOR_LOST = 7,
    FAULT_WINDING_RESISTANCE = 8,
};

/* Which sensor a fault is on. */
enum fault_sensor {
    FAULT_ON_NONE = 0,
    FAULT_ON_STATOR = 1,
    FAULT_ON_DRIVE_END = 2,
    FAULT_ON_NON_DRIVE_END = 3,
    FAULT_ON_AMBIENT = 4,
    FAULT_ON_CURRENT = 5,
};

enum gateway_state {
    GATEWAY_STARTING = 1,
    GATEWAY_RUNNING = 2,
    GATEWAY_DEGRADED = 3,
    GATEWAY_SILENT = 4,
};

/* How long evidence must hold before a flag follows it. */
struct flag_timing {
    int64_t good_ns;  /* unknown to good */
    int64_t raise_ns; /* to bad */
    int64_t clear_ns; /* bad to good */
};

/* From evidence to flags; constant. */
struct flag_rules {
    struct flag_timing timing[FLAG_KINDS]; /* by enum flag_kind */
    struct flag_timing
        severe;               /* of adhesion, where so little load is carried that it is no noise */
    double raise_probability; /* of lost adhesion: bad from here on */
    double clear_probability; /* good up to here; between the two: unchanged */
    int64_t tick_ns;          /* period of the loop */
};

/* One flag: what is sent, and the evidence that may change it. */
struct flag {
    int64_t
        since_ns;  /* since when the evidence is the same; a tick of FLAG_UNCHANGED moves it on */
    uint8_t state; /* enum flag_state */
    uint8_t evidence; /* enum flag_state: the last that was not FLAG_UNCHANGED */
};

/* What the stations before have found of one drive in this tick. */
struct flag_inputs {
    double loss_probability;   /* of adhesion, 0 to 1; anything else is unknown */
    double speed_rad_s;        /* of the rotor; NaN: not known */
    double load_nm;            /* NaN: not known */
    double load_sigma_nm;      /* standard deviation of the load; NaN: not known */
    double nis;                /* normalised innovation squared, smoothed; NaN: not known */
    double mixed_c;            /* estimated temperature of the winding, degC; NaN: not known */
    double maisd_k;            /* thermal measure MAISD, K; NaN: not known */
    double rate_k_h;           /* of degradation, K/h; NaN: not known */
    int64_t jumps;             /* steps of temperature that were counted */
    int64_t sample_ns;         /* stamp of the newest sample of current; negative: none */
    int64_t temperature_ns;    /* stamp of the last temperatures; NO_TIME: none */
    uint8_t input_reason;      /* enum reason why currents and voltages are not valid */
    uint8_t input_implausible; /* 1: currents and voltages contradict the measured speed */
    uint8_t current_sum_fault; /* 1: the sum of the phase currents is not zero */
    uint8_t comm;              /* enum flag_state: evidence of the messages of the drive */
    uint8_t health;            /* enum filter_health */
    uint8_t health_reason;     /* enum reason why the filter does not track */
    uint8_t loss_known;        /* 1: the detector has compared this drive */
    uint8_t may_spin_up;       /* 1: the rotor may run away: no evidence of adhesion */
    uint8_t severe_loss;       /* 1: so little load is carried that noise is not the cause */
    uint8_t thermal;           /* enum flag_state: evidence of the temperatures */
    uint8_t sensor;            /* enum flag_state: evidence of the temperature sensors */
    uint8_t thermal_reason;    /* enum reason why `thermal` is unknown */
    uint8_t fault_class;       /* enum fault_class */
    uint8_t fault_sensor;      /* enum fault_sensor */
};

/* What is known of all drives together in this tick. */
struct train_inputs {
    uint8_t integrity_reason; /* enum reason why no adhesion flag is valid, or REASON_NONE */
    uint8_t common_mode;      /* enum flag_state: all drives have lost adhesion at once */
    uint8_t silent;           /* 1: the gateway sends nothing any more */
    uint8_t overrun;          /* 1: ticks were missed of late */
};

/* Evidence of one drive in this tick. */
struct drive_evidence {
    uint8_t of[FLAG_KINDS];  /* enum flag_state, by enum flag_kind */
    uint8_t adhesion_reason; /* enum reason, should the adhesion flag be unknown */
    uint8_t severe_loss;     /* 1: a loss is raised by the times of `severe` */
};

/* What is sent of one drive. */
struct drive_status {
    struct flag flag[FLAG_KINDS]; /* by enum flag_kind */
    double speed_rad_s;           /* NaN: not known, and so with all numbers here */
    double load_nm;
    double load_sigma_nm;
    double loss_probability; /* 0 to 1 */
    double nis;
    double mixed_c;
    double maisd_k;
    double rate_k_h;
    int64_t jumps;
    int64_t age_ns;             /* of the newest sample of current; NO_TIME: none */
    int64_t temperature_age_ns; /* NO_TIME: none */
    uint8_t adhesion_reason;    /* enum reason; REASON_NONE unless the flag is unknown */
    uint8_t thermal_reason;     /* enum reason; REASON_NONE unless the flag is unknown */
    uint8_t health;             /* enum filter_health */
    uint8_t fault_class;        /* enum fault_class */
    uint8_t fault_sensor;       /* enum fault_sensor */
};

/* What is sent of all drives together. */
struct train_status {
    int64_t age_ns;             /* the oldest of all drives; NO_TIME while one has none */
    int64_t temperature_age_ns; /* likewise */
    uint8_t adhesion_reason;    /* enum reason: the worst of all drives */
    uint8_t faults_reason;      /* enum reason: the worst of all thermal flags */
    uint8_t sensor;             /* enum flag_state: bad if one is, else unknown if one is */
    uint8_t comm;               /* likewise */
    uint8_t estimator;          /* likewise */
    uint8_t overrun;            /* enum flag_state */
    uint8_t state;              /* enum gateway_state */
    uint8_t detector;           /* number of the detector in the DBC; written once */
    uint8_t common_mode;        /* enum flag_state */
};

/* Variational Bayes (estimators/detect/variational.c). */

#define VB_MAX_STARTS 16 /* drives that are tried as the adhering one */

/* Strength of what is known before looking; constant. */
struct vb_priors {
    double nu;             /* degrees of freedom of both precisions */
    double beta_adhering;  /* weight of the mean of adhering loads, in drives */
    double beta_lost;      /* weight of the mean of lost loads, in drives */
    double alpha_adhering; /* weight of the share of adhering drives, in drives */
    double alpha_lost;     /* weight of the share of lost drives, in drives */
};

/* Loads of healthy drives, and their answers to commands (estimators/detect/load_reference.c,
 * command_response.c). Torques are per unit of rated torque. */

/* Of all drives: how far loads of healthy ones scatter. */
struct load_spread {
    double spread;     /* standard deviation, as learnt */
    double configured; /* standard deviation at the start */
};

/* What the load of one drive is while it adheres. */
struct load_ratio {
    double ratio;    /* load over the common one */
    double variance; /* of `ratio` */
    double residual; /* of the last observation */
    uint8_t seen;    /* 1: there was one */
    uint8_t taught;  /* 1: the last observation has changed `ratio` */
};

/* One observation of the load of one drive. */
struct load_observation {
    double load;
    double common;   /* load that adhering drives share, or the command of this drive */
    uint8_t known;   /* 1: both are known */
    uint8_t healthy; /* 1: the drive certainly adheres */
};

/* Load of one drive beside its command, positive in the direction of the motor. */
struct command_response {
    double load;
    double
        acceleration_torque; /* that accelerates the rotor, largest of two ticks; 0: not wanted */
    double command;
    double previous_command; /* the command before that */
    double command_age_s;    /* since the command was sent */
    double deficit_s;        /* how long a deficit has stood; 0: none */
    uint8_t usable;          /* 1: load and command are known */
};

/* The train as its rotors and commands show it together (gateway/core/train.c). Speeds are those of
 * rotors, rad/s; loads and torques are per unit of rated torque; NaN: not known. */

/* One rotor: its ratings, and what is remembered of it. */
struct rotor {
    double rated_nm;            /* rated torque */
    double inertia_kg_m2;       /* of the rotor */
    double speed;               /* of this tick */
    double load;                /* of this tick, in the direction of the train */
    double slow_speed;          /* smoothed, to find the acceleration */
    double acceleration_torque; /* that accelerates the rotor with its train */
    double diameter;            /* of the wheel over those of the others, as speeds */
    double learnt_s;            /* for how long `diameter` has been learnt */
    double creep;               /* speed over that of the others, minus 1 */
    double followed_s;          /* for how long the filter has tracked */
    double alone_s;             /* for how long all others have been away */
    double near_s;              /* for how long it has been within the largest creep */
    double slides_s;            /* for how long it has carried more than the others while apart */
    double uncommanded_s;       /* for how long it has carried what it was not asked for */
    double odd_s;               /* for how long its command has been odd */
    int64_t doubt_until_ns;     /* until then its currents accuse nobody; NO_TIME: not in doubt */
    int32_t motor;              /* rotors with the same number have the same ratings */
    uint8_t far;                /* 1: too far from the others, the diameter not being known */
    uint8_t apart;              /* 1: too far from the others when that was last known */
    uint8_t away;               /* 1: ran away from the others by its effort, and is not back yet */
    uint8_t uncertain;          /* 1: it may be running away, or braked by something else */
    uint8_t odd;                /* 1: its command has been odd for too long */
    uint8_t above;              /* 1: carries more than its command and than the others */
};

/* What the stations before have found of one drive in this tick. */
struct rotor_inputs {
    double measured_rad_s;      /* by `Motion`; NaN: none that is fresh */
    double speed_rad_s;         /* estimated */
    double load_nm;             /* estimated */
    double command_nm;          /* torque command */
    double previous_command_nm; /* the command before that */
    uint8_t health;             /* enum filter_health; changed where the drive is not judged */
    uint8_t health_reason;      /* enum reason; written where the drive is not judged */
    uint8_t adhesion;           /* enum flag_state: the adhesion flag so far */
    uint8_t operating;          /* 1: the drive is in operation */
    uint8_t command_valid;      /* 1: the command is known; cleared where it cannot be right */
    uint8_t not_judged;         /* 1: the estimate is not used; written */
};

#endif
