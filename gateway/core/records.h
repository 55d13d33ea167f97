/* Records of the core: one line per field, with unit and meaning.
 *
 * The compiler, cffi and NumPy (dbc/records.py) all read this file, so a layout stands here once.
 * Only `#define` of a number, `enum` and `struct` are allowed: cffi reads nothing else. Longer than other
 * files, as every record of the core stands here and nowhere else. */
#ifndef TRACTION_RECORDS_H
#define TRACTION_RECORDS_H

#include <stddef.h>
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
    double creep;             /* of the wheel: see creep.c, */
    double creep_sigma;       /* its standard deviation */
    double utilisation;       /* load over rated torque, without its sign, */
    double utilisation_sigma; /* its standard deviation */
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
    double braked_load; /* the same, if friction brakes slow the train; as `load` in traction */
    double
        acceleration_torque; /* that accelerates the rotor, largest of two ticks; 0: not wanted */
    double command;
    double previous_command; /* the command before that */
    double command_age_s;    /* since the command was sent */
    double deficit_s;        /* how long a deficit has stood; 0: none */
    uint8_t usable;          /* 1: load and command are known */
    uint8_t braked;          /* 1: friction brakes are taken for why load is missing */
};

/* ---- signals: where their bits are and what they mean (dbc/decode.c, dbc/encode.c) ---- */

#define MAX_LISTED_BITS 8  /* of a selector by which the signals in a frame are listed */
#define PAYLOAD_BYTES   64 /* a row of payload, whatever the frame's length; zeros behind it */

/* What a raw value says of itself, before any scaling. */
enum signal_validity {
    SIGNAL_VALID = 0,
    SIGNAL_NOT_AVAILABLE = 1, /* the DBC's code for "not available" */
    SIGNAL_OUT_OF_RANGE = 2,  /* outside of the DBC's range; a float: also NaN and infinity */
    SIGNAL_SATURATED = 3,     /* at an end of a signed range: the true value may lie beyond */
    SIGNAL_ABSENT = 4,        /* not in this frame: multiplexed away, or an unused column */
};

enum signal_type {
    SIGNAL_INTEGER = 0, /* signed, or unsigned of at most 63 bits */
    SIGNAL_UINT64 = 1,  /* unsigned of 64 bits */
    SIGNAL_FLOAT32 = 2,
    SIGNAL_FLOAT64 = 3,
};

/* One signal of a message; constant. A key is a raw value with its sign bit turned over: keys of
 * signed and of unsigned signals are ordered alike. */
struct signal {
    uint64_t mask;        /* as many ones as it has bits */
    uint64_t sign;        /* its sign bit; 0: unsigned, or a float */
    uint64_t key_min;     /* lowest and */
    uint64_t key_max;     /* highest key in range */
    uint64_t key_none;    /* key of the not-available code, if `has_none` */
    uint64_t valid_first; /* first key of a run that is valid at one look and */
    uint64_t valid_count; /* length of that run; others can be valid, too */
    uint64_t start;       /* bits of its start value */
    double scale;         /* physical unit per raw step; not 0 */
    double offset;        /* physical value of raw 0 */
    double float_min;     /* lowest and */
    double float_max;     /* highest physical value in range; floats only */
    uint32_t first_range; /* index of the first `struct mux_range` that selects it */
    uint16_t range_count; /* number of these */
    uint16_t multiplexer; /* index in its message of the signal that selects it */
    uint16_t mux_depth;   /* selectors above it; 0: in every frame */
    uint8_t first_byte;   /* index of the first of the eight bytes that hold it, 0 to 56 */
    uint8_t shift;        /* bits below it in these eight bytes, 0 to 63 */
    uint8_t ninth_bits;   /* bits of it in the byte behind these, 0 to 7 */
    uint8_t big_endian;   /* byte order: 1 Motorola, 0 Intel */
    uint8_t type;         /* enum signal_type */
    uint8_t has_none;     /* 1: it has a not-available code */
    uint8_t saturates;    /* 1: the ends of its range mean "or beyond" */
};

/* One message; constant. It is listed if it has one selector, of at most MAX_LISTED_BITS bits, and
 * at most 64 signals: what is in a frame is then looked up by the selector's bits. */
struct message {
    uint32_t first_signal;  /* index of its first `struct signal`; the others follow */
    uint32_t first_present; /* index in `present` of what the selector's value 0 selects */
    uint16_t signal_count;  /* number of its signals */
    uint16_t mux_depth;     /* largest of its signals'; 0: not multiplexed */
    uint16_t selector;      /* index in the message of the one selector, if `is_listed` */
    uint16_t is_listed;     /* 1: it is */
};

/* Values of a selector, both ends included; constant. */
struct mux_range {
    int64_t low;  /* lowest and */
    int64_t high; /* highest raw value */
};

/* A message set; constant. Made by dbc/codec_tables.py. */
struct codec {
    const struct message *messages;
    const struct signal *signals;
    const struct mux_range *mux_ranges;
    const uint64_t *present; /* signals in a frame of a listed message, a bit for each */
    int32_t message_count;
    int32_t width; /* columns of a decoded row: signals of the message that has most */
};

/* ---- Temperatures of the motors, and their thermal model ---- */

#define THERMAL_POINTS 3 /* with a sensor: stator winding, drive end, non-drive end */
#define READING_POINTS 4 /* those, then the ambient temperature */
#define THERMAL_LUMPS  5 /* of a motor's heat: enum thermal_lump */

/* What a motor's heat is lumped into (estimators/thermal/model.c). */
enum thermal_lump {
    THERMAL_WINDING = 0,
    THERMAL_CORE = 1,
    THERMAL_FRAME = 2,
    THERMAL_DRIVE_END = 3,
    THERMAL_OTHER_END = 4,
};

/* Thermal model of one motor; constant. Rates, not heat capacities: temperatures tell no more. */
struct thermal_parameters {
    double a;                        /* K/(s A^2), copper loss of the winding */
    double k_w;                      /* 1/s, winding to core */
    double k_c;                      /* 1/s, core from winding */
    double e_1;                      /* K/rad, iron loss by speed */
    double e_2;                      /* K s/rad^2, iron loss by its square */
    double g_c;                      /* 1/s, core to frame */
    double g_f;                      /* 1/s, frame from core */
    double h_0;                      /* 1/s, frame to the air at standstill */
    double h_1;                      /* 1/rad, and by speed */
    double k_d;                      /* 1/s, drive end from frame */
    double f_d;                      /* K/rad, friction of the drive end */
    double b_d;                      /* 1/s, drive end to the air */
    double k_n;                      /* 1/s, non-drive end from frame */
    double f_n;                      /* K/rad, friction of the non-drive end */
    double b_n;                      /* 1/s, non-drive end to the air */
    double offset_k[THERMAL_POINTS]; /* K, of each sensor */
};

/* What drives a motor's heat. */
struct thermal_input {
    double current_square; /* A^2, of the current's amplitude */
    double speed;          /* rad/s, of the rotor, without sign */
    double ambient;        /* degC */
};

#define STEP_WINDOW_MAX 1024 /* samples of before, after and settled together, at most */

/* How steps of sensors are looked for; constant. */
struct step_config {
    double step_k;   /* K, medians further apart are a step; 0: nothing is looked for */
    double back_k;   /* K, a sensor that is off by less is where it was */
    double drift_k;  /* K per sample, fastest that the level of a sensor without offset moves */
    int32_t before;  /* samples of the level before a step */
    int32_t after;   /* samples of the readings after it */
    int32_t settled; /* samples until it is measured: a burst is over by then */
};

/* What is known of the steps of one sensor; `step_reset` makes one that nothing is known of. */
struct step_state {
    double offset_k; /* K, that the sensor has stepped by */
    double level_k;  /* K, median of the residuals when they were last known; NaN: never */
    double home_k;   /* K, level of the sensor without offset; NaN: not known */
    int32_t since;   /* samples since a step that has not settled yet was seen; -1: none */
    int32_t unseen;  /* samples since `level_k` was known */
};

#define MIXTURE_MAX 8 /* components of a Gaussian mixture, at most */

/* A Gaussian mixture of a scalar, its components in the order of their means. */
struct mixture {
    double weight[MIXTURE_MAX];   /* they add up to 1 */
    double mean[MIXTURE_MAX];     /* of the scalar's unit */
    double variance[MIXTURE_MAX]; /* of its square */
};

/* Sigma-mixed filter of one motor (paper `thermal`); constant. */
struct sigma_mixed_config {
    double drift[THERMAL_POINTS]; /* K/s, degradation of each point */
    double q[THERMAL_POINTS];     /* K^2, variance of the model's error from sample to sample */
    double r[THERMAL_POINTS];     /* K^2, variance of a reading */
    double apart[THERMAL_POINTS]; /* K, usual distance of a point from the three points' mean */
    double kappa;                 /* of the sigma points */
    double mixing;                /* share of the common part that the mixture gives */
    int32_t weighted;             /* 1: the mixture's mean in place of (21) */
};

/* What it gets at one sample. */
struct sigma_mixed_sample {
    double y[THERMAL_POINTS];       /* degC, NaN without a reading */
    double settled[THERMAL_POINTS]; /* degC, where the inputs drive a point */
    double keep[THERMAL_POINTS];    /* share of the distance from there left after the gap */
    double gap;                     /* s since the last sample */
};

#define IMM_HEATS         5   /* kinds of heat: overheating, lost cooling, bearings, resistance */
#define IMM_MODES         9   /* nothing; a kind of heat each; a sensor that is off each */
#define IMM_DISTURBANCES  5   /* of every motor: copper, local air, fan, friction of both ends */
#define IMM_STATES        12  /* lumps K, disturbances, size of the fault K, its rate K/s */
#define THERMAL_KINDS     11  /* of faults: kinds of heat, sensors that are off, loose connectors */
#define THERMAL_BLOCK_MAX 128 /* samples of a block, and of what its steps are looked for in */

/* A fault that has just begun, of one mode. */
struct imm_fault {
    double mean_k;    /* K, mean of its size */
    double sigma_k;   /* K, standard deviation of its size */
    double creep_k_s; /* K/s, standard deviation of the rate at which it grows */
    double share;     /* of all faults that begin */
};

/* Interacting filters of every motor; constant. */
struct imm_config {
    double block_s;       /* s, from one block to the next */
    double begin_per_s;   /* 1/s, rate at which a fault begins */
    double end_per_s;     /* 1/s, rate at which one ends */
    double memory_s;      /* s, time constant of disturbances and of a sensor's creep */
    double unsure;        /* share of a lump's own exchange that the model may be off by */
    double walk_k;        /* K, walk of a heat's size per block */
    double walk_share;    /* walk of a size per block, as a share of it */
    double own_k;         /* K, a lump's own noise per root of a minute */
    double wide_k;        /* K, how far off a block may be that is not what it seems */
    double unsteady;      /* share of a block's heat that is not steady */
    double walk_sensor_k; /* K, walk of a sensor's error per block */
    double sigma[IMM_DISTURBANCES]; /* standard deviations of the disturbances */
    double benign_k[IMM_MODES - 1]; /* K, smaller faults of each kind are none */
    double shown_k;                 /* K, that heat has to have made of some reading */
    double ambiguous; /* share of a sensor's high reading that is as well heat: neither is named */
    struct imm_fault fault[IMM_MODES]; /* of each mode; the first has none */
    int32_t modes;                     /* that are looked at: IMM_MODES, or 1 for no fault at all */
};

/* What the inputs of one block make of disturbances and faults. */
struct imm_surroundings {
    double rates[THERMAL_LUMPS][THERMAL_LUMPS];     /* 1/s, system matrix */
    double pushes[THERMAL_LUMPS][IMM_DISTURBANCES]; /* K/s of a lump per unit of a disturbance */
    double heats[IMM_HEATS][THERMAL_LUMPS];         /* K/s of a lump per K of a kind of heat */
    double rise_k;                                  /* K, frame above the air */
};

/* What is believed of one motor: a filter per mode. */
struct imm_state {
    double mode[IMM_MODES];                        /* probabilities, their sum is 1 */
    double mean[IMM_MODES][IMM_STATES];            /* state vectors */
    double cov[IMM_MODES][IMM_STATES][IMM_STATES]; /* their covariances */
};

/* Sums of a motor's inputs over part of a block. */
struct thermal_sums {
    double current_square; /* A^2 */
    double speed;          /* rad/s */
    double cooling;        /* K/s, that the frame loses to the air */
    double copper;         /* K/s, that the winding is heated by */
    double rise;           /* K, frame above the air */
    double count;          /* samples */
};

/* Where the last block of one sensor ended. */
struct thermal_burst {
    double middle_k; /* K, median of the block */
    int32_t last;    /* readings far from it at the block's end */
};

/* One motor as fault-free runs have shown it; constant. */
struct thermal_motor_config {
    struct thermal_parameters model;
    double centre_k[THERMAL_POINTS]; /* K, residual beside the other motors' */
    double noise_k[THERMAL_POINTS];  /* K, of single readings */
    double block_noise_k;            /* K, of a block's medians */
    double inflation;                /* of the filters' standard deviations: at least 1 */
    uint8_t unexplained; /* 1: they leave even that band; the motor is not judged by its model */
};

/* The monitor of a train; constant. */
struct thermal_config {
    struct imm_config imm;
    struct step_config steps;
    double dt_s;         /* s, from one sample to the next */
    double gap_s;        /* s without inputs after which a motor starts again */
    double duty_speed;   /* rad/s, mean speed in the fault-free runs */
    double duty_cooling; /* K/s, mean cooling of the frame */
    double duty_copper;  /* K/s, mean heating of the winding */
    double settles_k
        [THERMAL_LUMPS];      /* K, where 1 K/s into a lump settles at the point that shows most */
    double loose_share;       /* of a loose connector's readings, that are far off */
    double good_share;        /* of a good connector's */
    double far_sigma;         /* standard deviations that are far */
    double burst_length;      /* readings of one burst: they are not independent */
    double far_k;             /* K within a block that are not far yet: heat can do that */
    double loose_begin_per_s; /* 1/s, rate at which a connector comes loose */
    double loose_end_per_s;   /* 1/s, rate at which one is mended */
    double learn_per_s;       /* 1/s, of a motor's baseline while there is no fault */
    double raise_probability; /* above which a fault is reported: at least 0.9 */
    int32_t block;            /* samples of a block, at least 1 */
};

/* What is remembered of one motor; `thermal_motor_reset` makes one that nothing is known of. */
struct thermal_motor {
    double lumps[THERMAL_LUMPS]; /* degC, by the model run open loop (enum thermal_lump) */
    double unknown_s;            /* s since its inputs were known */
    struct step_state step[THERMAL_POINTS];           /* of each sensor */
    struct thermal_burst burst[THERMAL_POINTS];       /* of each sensor */
    double window[THERMAL_POINTS][THERMAL_BLOCK_MAX]; /* K, latest residuals, the newest last */
    double block[THERMAL_POINTS][THERMAL_BLOCK_MAX];  /* K, residuals of this block, less steps */
    double raw[THERMAL_POINTS][THERMAL_BLOCK_MAX];    /* K, the same with steps */
    struct thermal_sums half[2];     /* of the inputs: first and second half of this block */
    struct thermal_sums late;        /* of the second half of the last block */
    struct thermal_sums inputs;      /* from the middle of the last block to that of this one */
    double middle_k[THERMAL_POINTS]; /* K, medians of the last block; NaN: too few readings */
    double bursts[THERMAL_POINTS]; /* log odds of the last block for a loose connector; NaN: none */
    double off_k[THERMAL_POINTS];  /* K, of the last block from the other motors; NaN: no others */
    double base_k[THERMAL_POINTS]; /* K, baseline that was learnt while there was no fault */
    double loose[THERMAL_POINTS];  /* probability of a loose connector */
    double kind[THERMAL_KINDS];    /* probability of each kind of fault, with hysteresis */
    double size_k;                 /* K, likely size of what is wrong */
    double log_likelihood;         /* of the last block */
    double fault_probability;      /* before hysteresis */
    struct imm_state imm;
    int32_t judged;  /* blocks that the motor was judged by */
    uint8_t started; /* 1: the model runs */
    uint8_t lost;    /* 1: it has to start again, its inputs were unknown for too long */
    uint8_t held;    /* 1: a fault is reported */
    uint8_t trusted; /* 1: others were compared with it in the last block */
};

#define HYPOTHESIS_SIZES  11  /* sizes of a fault that are tried */
#define HYPOTHESIS_STATES 125 /* nothing, kinds times sizes, loose connectors: hypotheses.c */

/* Discrete Bayes filter over kinds and sizes of faults; constant. Rates are per sample. */
struct hypothesis_config {
    double sizes_k[HYPOTHESIS_SIZES]; /* K, ascending */
    double benign_k[IMM_MODES - 1];   /* K, least size that is a fault, of heats and sensors */
    double begin;                     /* rate at which a fault begins */
    double end;                       /* rate at which one ends */
    double growth;                    /* rate at which a size becomes the next larger, or smaller */
    double often;                     /* rate at which dirt, draught or weather begins */
    double learn;                     /* rate at which a baseline is learnt */
    double loose_end;                 /* rate at which a loose connector is forgotten */
    double tail;                      /* degrees of freedom of the readings' Student t */
    double log_t;                     /* logarithm of that density at its middle, unit scale */
    double loose_share;               /* of a loose connector's readings, that are off */
    double loose_k;                   /* K, how far off they may be */
};

/* What a healthy motor's residual beside its peers' is like; constant. */
struct hypothesis_spread {
    double sigma_k[THERMAL_POINTS];               /* K, standard deviations */
    double white[THERMAL_POINTS][THERMAL_POINTS]; /* 1/K, rows turn points into independent parts */
    double share[THERMAL_POINTS]; /* of an independent sample that one of each part counts as */
};

/* What is believed of one motor. */
struct hypothesis_state {
    double p[HYPOTHESIS_STATES];   /* probability of each state */
    double base_k[THERMAL_POINTS]; /* K, baseline that was learnt */
    double kind[THERMAL_KINDS];    /* probability of each kind of fault, benign sizes left out */
    double size_k;                 /* K, mean size if any */
    double rise_k;                 /* K, mean error of a sensor if any, positive: reads high */
    int32_t held;                  /* kind that is taken for a fault; -1: none */
    int32_t trusted;               /* 1: others are compared with it */
};

/* ---- Estimate: filters of the drives (estimators/acquisition.c, current_calibration.c,
 * adaptation.c). Complex numbers are vectors alpha + j beta of the stationary frame. */

#define ACQUISITION_PAIRS   20  /* consecutive plausible pairs of chords before `ready`: 40 ms */
#define FILTER_SETTLE_STEPS 480 /* sub-steps of a new filter before its load is valid: 60 ms */

/* Motor constants (paper `adhesion`, eq. (11)); of one drive. */
struct pmsm {
    double R_s;   /* stator resistance, ohm */
    double L_s;   /* inductance, H; L_d = L_q */
    double psi_f; /* flux of the magnets, Wb */
    double p;     /* pole pairs */
    double J;     /* moment of inertia at the shaft, kg m2 */
    double B;     /* friction, Nm s/rad */
    double k_p;   /* Park constant: 1.5 for amplitude-invariant alpha-beta */
};

/* What the filters see of one sample; a tick's samples are in order of time. */
struct filter_sample {
    double _Complex u; /* voltage, mean over the sample's interval, V */
    double _Complex i; /* current at the end of the interval, A */
    double nis;        /* normalised innovation squared; NaN where a filter skipped the sample */
    int64_t steps;     /* sub-steps in the interval, 1 or more */
    int64_t gap;       /* sub-steps missing before it */
    int64_t drive;     /* index of its drive */
    int64_t next;      /* index of the drive's next sample of this tick; -1: none. Of filter_run */
};

/* Speeds between which a drive is acquired, rad/s electrical; constant. */
struct acquisition_limits {
    double w_on;  /* ready from here upwards */
    double w_off; /* until below; above 7 rad/s, which R_s 20 % off at rated current looks like */
};

/* Flux chords of one drive; `acquisition_restart` makes one that has seen nothing. */
struct acquisition {
    double _Complex i_last;     /* current at the last sample, A */
    double _Complex i_start;    /* current where the open chord starts, A */
    double _Complex flux;       /* volt-seconds less resistive drop of the open chord, Wb */
    double _Complex chord;      /* the last complete chord c_(k-1), Wb */
    double _Complex S1;         /* mean of c_k conj(c_(k-1)), Wb^2 */
    double _Complex S2;         /* mean of S1, Wb^2 */
    double _Complex turned_sum; /* rotated sum of chords, Wb */
    double S0;                  /* mean of |c|^2, Wb^2 */
    double span;                /* duration of a chord, s */
    double w;                   /* speed at the end of the last paired chord, rad/s electrical */
    double theta;               /* angle there, rad */
    double age;                 /* time since then, s */
    double spread;              /* circular standard deviation of the turn of a chord, rad */
    double w_max;               /* largest |w| that the length of the chords allows, rad/s */
    double psi;           /* flux by length and turn, Wb, with errors of R_s; NaN: no pair yet */
    int64_t steps;        /* sub-steps of the open chord; -1: it has no start */
    int64_t paired_steps; /* sub-steps of the last chord; 0: the next cannot be paired with it */
    int64_t stride;       /* least sub-steps of the open chord */
    int64_t pairs;        /* pairs since the start */
    int64_t good;         /* consecutive plausible pairs */
    uint8_t ready;        /* 1: w and theta are valid */
};

/* Speed and angle of a filter compared with those of the flux chords. */
enum consistency {
    CONSISTENCY_UNKNOWN = 0,
    CONSISTENT = 1,
    INCONSISTENT = 2,
};

/* Integrals over the angle of the rotor of a current z. */
struct revolution_sums {
    double _Complex z;  /* A rad */
    double _Complex z2; /* of z^2, A^2 rad */
    double abs2;        /* of |z|^2, A^2 rad */
};

/* Errors of the current sensors of one drive; all 0: nothing learnt. */
struct current_calibration {
    double _Complex offset;             /* as learnt from `turns` revolutions, A */
    double _Complex image;              /* gain mismatch, as learnt */
    double _Complex offset_applied;     /* as subtracted now, A */
    double _Complex image_applied;      /* as compensated now */
    double _Complex line;               /* mean of z^2 / |z|^2; small currents count less */
    struct revolution_sums sum_uniform; /* of the revolution under way */
    struct revolution_sums sum_ramp;    /* the same, with a weight that rises from 0 to 1 */
    struct revolution_sums ramp_before; /* `sum_ramp` of the revolution before */
    double turned;                      /* angle of the revolution under way, rad */
    double mean_square;                 /* of the revolution before, A^2; 0: none */
    double seen;                        /* mean of 1 with the weight of `line` */
    double step_s;                      /* time between the last two samples, s */
    int64_t turns;                      /* revolutions learnt from, at most 16 */
    uint8_t single_axis;                /* 1: the current swings on one line (open phase) */
};

/* The filter of one drive. */
struct filter {
    double x[5];     /* i_alpha, i_beta (A), w_e (rad/s), theta_e (rad), T_L (Nm) */
    double P[5][5];  /* covariance of x */
    double nis;      /* normalised innovation squared, smoothed */
    double r_scale;  /* variance of the currents over the configured one, as innovations show it */
    double v_q_bias; /* voltage along q that the motor lacks against its data, V */
    int64_t steps;   /* sub-steps since the start; -1: it has just become not finite */
    int64_t first_sample; /* index of its first sample of this tick; -1: none. Of filter_run */
    uint8_t active;       /* 1: there is a filter */
    uint8_t is_finite; /* 0: in this tick it would have become not finite, or a variance negative */
};

/* What a filter takes for disturbance and noise; of one drive, constant. */
struct filter_noise {
    double Q[5];  /* variance of x added per sub-step */
    double R[2];  /* variance of the currents, A^2; `r_scale` multiplies it */
    double coast; /* variance of the currents in and after a gap, A^2 */
};

/* How all filters run; constant. */
struct filter_settings {
    double dt;         /* sub-step, s */
    double kappa;      /* of the UKF: above -5; 5 + kappa = 3 matches a Gaussian's kurtosis */
    uint8_t unscented; /* 1: UKF, 0: EKF */
};

/* The train as its rotors and commands show it together (gateway/core/train.c). Speeds are those of
 * rotors, rad/s; loads and torques are per unit of rated torque; NaN: not known. */

/* One rotor: its ratings, and what is remembered of it. */
struct rotor {
    double rated_nm;            /* rated torque */
    double inertia_kg_m2;       /* of the rotor */
    double speed;               /* of this tick; negative: turns backwards under its train */
    double load;                /* of this tick, in the direction in which it turns */
    double slow_speed;          /* smoothed, to find the acceleration, */
    double quick_speed;         /* and less smoothed */
    double acceleration_torque; /* that accelerates the rotor with its train */
    double brake_torque;        /* more of it, if friction brakes slow the train; else 0 */
    double braked_creep; /* creep of its wheel if they do not, and it was credited with that */
    double diameter;     /* of the wheel over those of the others, as speeds */
    double learnt_s;     /* for how long `diameter` has been learnt */
    double creep;        /* speed over that of the others, minus 1 */
    double slip;        /* speed over `train_speed`, minus 1; NaN: not known, or nothing is asked */
    double train_speed; /* of the first of its motor: bound of the train's speed; NaN: not known */
    double train_limit; /* the same for a train that changes its speed faster than any does */
    double unseen_s;    /* of the first: for how long no rotor has been tracked */
    double unsure_s;    /* of the first: for how long none has been known to adhere (creep.c), */
    double sure_speed;  /* and `train_speed` until then; 0: not known */
    double sliding_s;   /* for how long it has been far beyond `train_limit` */
    double ahead_s;     /* for how long it has been ahead of `train_speed`, and has carried */
    double followed_s;  /* for how long the filter has tracked */
    double alone_s;     /* for how long all others have been away */
    double near_s;      /* for how long it has been within the largest creep */
    double slides_s;    /* for how long it has carried more than the others while apart */
    double uncommanded_s;        /* for how long it has carried what it was not asked for */
    double odd_s;                /* for how long its command has been odd */
    int64_t unreliable_until_ns; /* until then its currents accuse nobody; NO_TIME: reliable */
    int32_t motor;               /* the first rotor with the same ratings; constant */
    int32_t next_alike;          /* the next one with the same ratings; 0: none */
    int8_t way;                  /* sign of its speed when it last adhered; 0: unknown (creep.c) */
    uint8_t far;                 /* 1: too far from the others, the diameter not being known */
    uint8_t apart;               /* 1: too far from the others when that was last known */
    uint8_t away;      /* 1: ran away from the others by its effort, and is not back yet */
    uint8_t sliding;   /* 1: so far from the train's speed that it is lost, whatever it carries */
    uint8_t uncertain; /* 1: it may be running away, or braked by something else */
    uint8_t odd;       /* 1: its command has been odd for too long */
    uint8_t above;     /* 1: carries more than its command and than the others */
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

/* One temperature sensor; the first three are constants. Stamps are INT64_MIN before any. */
struct temperature_sensor {
    double limit_k;         /* K, a change beyond it that stays is an offset */
    int64_t stuck_after_ns; /* a value held for longer is a stuck sensor's */
    uint8_t configured;     /* 1: the drive has this sensor */
    uint8_t seen;           /* 1: there was a valid value */
    uint8_t saturated;      /* 1: it has warmed up to the signal's maximum, and may stay there */
    uint8_t moved;          /* 1: it has given two different values */
    uint8_t impossible;     /* 1: colder than it gets, or at the maximum from the start */
    uint8_t near;           /* 1: it has been near the other motors' since it began */
    int32_t step_count;     /* readings in a row that were beyond the limit */
    int64_t raw;            /* last valid value, tenths of a degree; -1: none */
    int64_t changed_ns;     /* stamp since which it has been that */
    int64_t valid_ns;       /* stamp of the last valid value */
    double value_c;         /* degC, last valid value */
    double level_c;         /* degC, its average, without offset */
    double slope_k;         /* K per reading, of the latest ones */
    double step_k;          /* K, largest change between two of the readings in `step_count` */
    double bias_k;          /* K, offset of the sensor; 0: none */
    int64_t valid_at;       /* which of the drive's readings, from 1, was its last valid one */
    int64_t step_index;     /* which of them gave it its offset */
};

/* Temperature sensors of one drive. */
struct temperature_drive {
    int64_t period_ns;   /* cycle of the readings; constant */
    int64_t received_ns; /* stamp of the last reading */
    int64_t first_ns;    /* stamp of the first one */
    int64_t readings;    /* how many there were */
    struct temperature_sensor sensor[THERMAL_POINTS];
};

/* ---- received messages (gateway/core/receive.c, pairing.c, supervision.c); times in ns, -1: none */

#define MAX_USED_COLUMNS 33 /* signals of one message that the gateway uses */
#define PAIR_COUNTERS    16 /* values of the counter by which currents and voltages are paired */
#define STANDARD_IDS     2048
#define HEARTBEAT_NODES  128
#define HEARTBEAT_GAPS   5 /* the period is the median of so many */
#define TIMEOUT_PERIODS  3 /* consumer time-out in heartbeat periods */

/* What a message carries; the first three become samples. */
enum channel_kind {
    KIND_CURRENTS = 0,
    KIND_VOLTAGES = 1,
    KIND_BLOCK = 2, /* eight samples of both */
    KIND_MOTION = 3,
    KIND_TEMPERATURES = 4,
    KIND_STATUS = 5,
};

/* What an identifier is, where it is no channel's number. */
enum id_owner {
    ID_UNKNOWN = -1,
    ID_OWN = -2,        /* the gateway's own */
    ID_SUPERVISED = -3, /* heartbeat or emergency of a drive's node */
};

/* Every received frame ends in one of these counters; RX_LOST counts frames that did not come. */
enum rx_counter {
    RX_DECODED = 0,
    RX_ERROR_FRAME = 1,
    RX_REMOTE = 2,
    RX_OWN = 3,
    RX_TIME_BACK = 4, /* stamp before the last one of its message, below 0, or after now */
    RX_WRONG_LENGTH = 5,
    RX_ERROR = 6, /* wrong checksum */
    RX_REPEATED = 7,
    RX_WRONG_SEQUENCE = 8,
    RX_LOST = 9,
    RX_NOT_YET_VALID = 10,
    RX_NOT_AVAILABLE = 11,
    RX_RANGE = 12,
    RX_UNKNOWN_ID = 13,
    RX_CANOPEN = 14,
    RX_COUNTERS = 15,
};

/* Signs of a second sender of one message. */
struct sequence_guard {
    double shortest_step_ns;   /* constant: a counter step in less time is a sign */
    int64_t counter_ns;        /* frame that the next counter is compared with */
    int64_t error_ns;          /* last sign */
    int64_t rejected_until_ns; /* enough signs: until then no frame is used */
    int32_t errors;            /* signs */
    int32_t repeats;           /* see MAX_REPEATS in sequence.c */
};

/* One received message of one drive. */
struct channel {
    /* constants */
    int64_t period_ns;
    int64_t limit_ns;     /* older, it is stale: three periods and a tick */
    int32_t message;      /* its number in the codec */
    int32_t drive;        /* position in the configuration */
    int32_t signal_count; /* columns of a decoded row */
    int32_t quality;      /* column of `Quality`; -1: it has none */
    int32_t steps;        /* sub-steps of 125 us between two samples */
    int32_t column_count; /* number of used columns */
    int32_t columns
        [MAX_USED_COLUMNS]; /* signals that the gateway uses, in gateway/core/channel.py's order */
    uint8_t kind;           /* enum channel_kind */
    struct e2e_config e2e_config;
    /* state */
    struct e2e_state e2e_state;
    int64_t received_ns; /* last frame, good or bad */
    int64_t accepted_ns; /* last frame with good protection */
    int64_t good_ns;     /* last frame whose values could be used */
    struct sequence_guard guard;
    uint8_t last_frame[PAYLOAD_BYTES]; /* bytes of the last frame with a good checksum */
    uint8_t reject_reason;             /* why the last values could not be used (enum reason) */
    uint8_t protection_reason;         /* what last went wrong in the protection */
    uint8_t reason;                    /* why the channel is unknown now; REASON_NONE: it is not */
    uint8_t was_valid;                 /* 1: its receiver was once in E2E_SM_VALID */
};

/* Currents or voltages that wait for the other half of a sample. */
struct half_sample {
    double value[2]; /* alpha, beta; A or V */
    int64_t t_ns;    /* -1: none waits */
};

/* When one drive's samples were taken (gateway/core/sample_clock.c). */
struct sample_clock {
    int64_t late_ns;  /* how much later than due the last sample came */
    int64_t mean_ns;  /* mean period */
    int64_t usual_ns; /* how late they come as a rule */
    int64_t samples;  /* since its start, as many as it needs */
    double u[2];      /* voltage of the last sample, V, alpha and beta */
    double turn[2];   /* mean product of each with the one before, V^2, as a complex number */
};

/* What one drive has sent; NaN: not yet. */
struct drive_input {
    struct half_sample pending[2][PAIR_COUNTERS]; /* by enum channel_kind, by counter */
    int64_t sample_ns;                            /* stamp of the last sample */
    int64_t sample_counter;                       /* and its counter */
    struct sample_clock clock;
    int64_t newest_sample;   /* its row in this tick; -1: none */
    double current_sum;      /* smoothed |Ia + Ib + Ic|, A */
    double speed;            /* rotor speed, rad/s */
    double command;          /* torque command, Nm */
    double previous_command; /* the one before, Nm */
    double irms;             /* A, sent with the command */
    int64_t command_ns;      /* stamp of the command */
    uint8_t command_steady;  /* 1: it hardly differs from the one before */
    uint8_t operating;       /* 1: `State` is Operation, or the drive sends none */
    uint8_t restart;         /* 1: its filter starts anew in this tick */
};

/* Heartbeat of one node (CiA 301); INT64_MIN is no stamp here. */
struct heartbeat {
    int64_t last_ns;                /* newest frame; INT64_MIN: none */
    int64_t since_ns;               /* heartbeat from which the next gap counts; INT64_MIN: none */
    int64_t gap_ns[HEARTBEAT_GAPS]; /* last gaps between two heartbeats, a ring */
    int64_t gaps;                   /* how many there were; -1: after an answer to node guarding */
    int64_t limit_ns;               /* consumer time-out; 0: not supervised */
    int64_t boots;                  /* boot-up messages */
    int64_t state;                  /* NMT state; -1: none yet */
    int64_t asked;                  /* 1: a node-guard request since the last frame */
};

/* Heartbeats of all nodes. */
struct supervision {
    struct heartbeat *nodes;
    int64_t malformed;  /* frames of a wrong format */
    int64_t timeout_ns; /* shortest time-out */
    int64_t period_ns;  /* configured period; 0: as it is received */
    int32_t node_count;
    int32_t row[HEARTBEAT_NODES]; /* index in `nodes` of a node number; -1: none of ours */
};

/* 29-bit and 11-bit identifiers in ascending order. */
struct id_entry {
    int64_t key;     /* identifier; bit 31 set for a 29-bit one */
    int64_t channel; /* index of its channel, or enum id_owner */
};

/* What the frames of a tick left behind. */
struct received {
    int64_t accepted;     /* frames that may be used */
    int64_t samples;      /* rows of samples */
    int64_t motions;      /* readings of Motion */
    int64_t temperatures; /* rows of temperatures */
    int64_t emergencies;  /* emergencies of the drives' nodes */
    int64_t restarts;     /* drives whose filter starts anew */
    int64_t own;          /* frames with the gateway's own identifiers */
};

/* Everything that receives. Room in all arrays for as many frames as a tick may have. */
struct receiver {
    const struct codec *codec;
    struct channel *channels;
    struct drive_input *drives;
    struct supervision *supervision;
    const struct id_entry *ids;
    int64_t channel_count;
    int64_t drive_count;
    int64_t id_count;
    int64_t max_gap_ns;                 /* longer without a sample, a drive's filter starts anew */
    int64_t standard_ids[STANDARD_IDS]; /* as `id_entry.channel`, of every 11-bit identifier */
    /* accepted frames of the tick, decoded */
    int64_t *channel;
    int32_t *message;
    int64_t *t_ns;
    uint8_t *payload;
    double *value;
    uint8_t *validity;
    /* samples of the tick, in the order of the filters' rows (gateway/core/pairing.py) */
    int32_t *sample_drive;
    double *sample_u; /* V, alpha and beta */
    double *sample_y; /* A, alpha and beta */
    int64_t *sample_steps;
    int64_t *sample_gap;
    int64_t *sample_before; /* row of the one before of the same drive; -1: none in this tick */
    /* readings of Motion in the tick (gateway/core/pairing.py) */
    int64_t *motion_drive;
    int64_t *motion_t_ns;
    double *motion_speed;  /* rad/s */
    double *motion_torque; /* Nm */
    double *motion_angle;  /* rad */
    /* rows that Python looks at */
    int64_t *temperature_rows;     /* accepted frames with temperatures */
    int64_t *emergency_rows;       /* received frames that are emergencies */
    int64_t received;              /* frames, since the start */
    int64_t counters[RX_COUNTERS]; /* what became of them, since the start */
    int64_t unpaired;              /* halves of samples that found no other, since the start */
    int64_t late;                  /* samples that came too late, since the start */
    int64_t left_out;              /* samples that senders left out without counting them */
    struct received tick;
};

/* ---- sent messages, and the load of the bus (gateway/core/transmit.c, busload.c) */

#define DATA_LENGTHS 256 /* numbers of data bytes that a frame's length can say */

/* Where the value of a sent signal comes from. */
enum tx_source {
    TX_START_VALUE = 0, /* nowhere: the signal keeps its start value */
    /* of a drive */
    TX_ADHESION = 1,
    TX_THERMAL = 2,
    TX_HEALTH = 3,
    TX_SPEED = 4,            /* 1/min */
    TX_LOAD = 5,             /* Nm */
    TX_LOSS_PROBABILITY = 6, /* % */
    TX_NIS = 7,
    TX_FAULT_CLASS = 8,
    TX_FAULT_SENSOR = 9,
    TX_MIXED = 10, /* degC */
    TX_MAISD = 11, /* K */
    TX_RATE = 12,  /* K/h */
    TX_JUMPS = 13,
    TX_QUALITY = 14,           /* of the next four, enum quality */
    TX_CREEP = 15,             /* % */
    TX_CREEP_SIGMA = 16,       /* % */
    TX_UTILISATION = 17,       /* % */
    TX_UTILISATION_SIGMA = 18, /* % */
    /* of the train */
    TX_ADHESION_REASON = 19,
    TX_FAULTS_REASON = 20,
    TX_SENSOR = 21,
    TX_COMM = 22,
    TX_ESTIMATOR = 23,
    TX_OVERRUN = 24,
    TX_STATE = 25,
    TX_DETECTOR = 26,
    TX_COMMON_MODE = 27,
    TX_AGE = 28,             /* ms */
    TX_TEMPERATURE_AGE = 29, /* ms */
    /* of what is counted and measured */
    TX_DEADLINE_MISSES = 30,
    TX_REJECTED = 31,
    TX_LOST = 32,
    TX_BUS_LOAD = 33, /* % */
    TX_LATENCY = 34,  /* us */
    TX_LATENESS = 35, /* us */
    TX_CONFIG_HASH = 36,
};

/* What a sender thinks of the values of a message; the numbers are those of the DBC. */
enum quality {
    QUALITY_INITIALISING = 0,
    QUALITY_VALID = 1,
    QUALITY_DEGRADED = 2,
};

/* One signal of a sent message; constant. */
struct tx_signal {
    uint8_t source; /* enum tx_source */
    uint16_t drive; /* index of the drive that it is of */
};

/* One message that the gateway sends. */
struct tx_message {
    /* constants */
    int64_t cycle_ns; /* at least 1 */
    struct e2e_config e2e_config;
    int32_t signal_count;
    uint8_t on_change; /* 1: sent at a change of the flags that faults are told by, too */
    const struct tx_signal *signals;
    /* state */
    int64_t next_ns; /* when it is due */
    uint8_t counter; /* frames sent, modulo 256 */
};

/* One frame that is sent. */
struct tx_frame {
    int64_t t_ns;
    int32_t message; /* index of its `struct tx_message` */
    uint8_t data[PAYLOAD_BYTES];
};

/* What is counted and measured, as it is sent. NaN: not known. */
struct gateway_counts {
    double deadline_misses;  /* ticks that were skipped */
    double rejected;         /* frames with a known identifier whose values were not used */
    double lost;             /* frames that did not come */
    double bus_load_percent; /* see busload.c */
    double latency_p99_us;   /* measured by the driver */
    double lateness_p99_us;  /* likewise */
    double config_hash;      /* of the configuration; constant */
    int64_t rejected_before; /* of `rejected`: before frames are received, by a translator */
};

/* Everything that sends; messages in the order of their identifiers. */
struct transmitter {
    /* constants */
    const struct codec *codec; /* whose messages these are */
    struct tx_message *messages;
    int32_t message_count;
    int32_t drive_count;
    int64_t tick_ns;  /* period of the loop */
    int64_t slack_ns; /* what is due within this is due now */
    /* state */
    struct gateway_counts counts;
    uint8_t *thermal_sent;   /* (drives) thermal flags of the last tick (enum flag_state) */
    uint8_t summary_sent[4]; /* sensor, comm, estimator and overrun of the last tick */
    /* workspace for one frame: (width of the codec) */
    double *value;
    uint8_t *given;
};

/* Share of the bus in use, worst-case stuffing, over the last full second. */
struct bus_load {
    double classic_s[DATA_LENGTHS]; /* s, of a classic frame by its number of data bytes */
    double fd_s[DATA_LENGTHS];      /* s, of a CAN FD frame */
    int64_t since_ns;               /* start of the window */
    double busy_s;                  /* s, frames of the window */
    double percent;                 /* of the last window; NaN: none yet */
};

/* ---- degradation, and a train's thermal monitor (estimators/thermal/trend.c, monitor.c) */

/* How fast one motor grows warmer than the others: a local linear trend. */
struct trend {
    double level_k;    /* K above the others; NaN: nothing seen yet */
    double rate_k_h;   /* K/h */
    double cov[2][2];  /* covariance of level and rate */
    double observed_h; /* h of readings */
};

/* Monitor of all motors; `struct thermal_motor` holds what is remembered of each. */
struct thermal_monitor {
    const struct thermal_config *config;
    const struct thermal_motor_config *known; /* (motor_count) */
    struct thermal_motor *motors;             /* (motor_count) */
    double *workspace;                        /* 8 numbers per motor */
    int32_t motor_count;
    int32_t position; /* samples of the block that is under way */
    int32_t waiting;  /* motors of the last block that are not judged yet, the last ones */
};

/* ---- temperatures in the gateway (gateway/core/thermal.c, thermal_evidence.c) */

/* What is averaged over a second: the sensors' temperatures, degC, and behind them these. */
enum thermal_quantity {
    THERMAL_CURRENT_SQUARE = 3, /* A^2, of the current's amplitude */
    THERMAL_SPEED = 4,          /* rad/s, without sign */
    THERMAL_AMBIENT = 5,        /* degC */
    THERMAL_QUANTITIES = 6,
};

/* How motors are judged. */
enum thermal_method {
    THERMAL_UNCALIBRATED = 0, /* not at all */
    THERMAL_MAISD = 1,        /* by how they differ from one another (estimators/maisd.c) */
    THERMAL_MODEL = 2,        /* by their thermal models (estimators/thermal/monitor.c) */
};

/* Evidence of one motor's temperatures. NaN: not known. */
struct thermal_evidence {
    double mixed_c;       /* degC, mean over the sensors that are valid */
    double maisd_k;       /* K, largest MAISD of all points */
    double rate_k_h;      /* K/h, of degradation */
    int64_t jumps;        /* steps of its sensors */
    uint8_t thermal;      /* enum flag_state */
    uint8_t sensor;       /* enum flag_state */
    uint8_t reason;       /* enum reason why `thermal` is unknown */
    uint8_t fault_class;  /* enum fault_class */
    uint8_t fault_sensor; /* enum fault_sensor */
};

/* Temperatures of one drive's motor. */
struct motor_temperatures {
    /* constants */
    int64_t age_limit_ns; /* older readings are stale */
    int32_t status;       /* index of the channel with current and command; -1: none */
    int32_t motion;       /* index of the channel with the speed; -1: none */
    /* state */
    double ambient_c;                  /* as last received; NaN: not valid */
    double total[THERMAL_QUANTITIES];  /* sums of the second that is under way */
    double number[THERMAL_QUANTITIES]; /* values in each of these */
    double mean[THERMAL_QUANTITIES];   /* of the last complete second; NaN: no value */
    struct trend trend;
    double step_k[THERMAL_POINTS];    /* K, that each sensor has stepped by, as last seen */
    int64_t jumps;                    /* how often that has changed */
    struct thermal_evidence evidence; /* as last judged */
    int64_t valid_until_ns;           /* until then it stands; NO_TIME: to be judged anew */
    uint8_t fresh;                    /* 1: its readings are within their age limit */
};

/* Temperatures over a window, (drives, THERMAL_POINTS), and how they differ: MAISD. */
struct temperature_window {
    /* constants */
    double *gain;                   /* of each sensor against the fleet */
    double *offset_k;               /* K, likewise */
    double limit_k[THERMAL_POINTS]; /* K, of `spread` */
    double apart_k[THERMAL_POINTS]; /* K, of `deviation` */
    int32_t samples;                /* of the window */
    /* state */
    double *ring;      /* (samples, drives, THERMAL_POINTS) degC, NaN: not valid */
    double *value;     /* last valid values, degC */
    uint8_t *valid;    /* 1: that is valid now */
    double *mean;      /* over the window, degC */
    uint8_t *known;    /* 1: that is known, and the sensor is valid now */
    double *centred;   /* mean less offset, over gain, K */
    double *deviation; /* K from the median of the others, by the nearer centring; NaN: none */
    double spread[THERMAL_POINTS]; /* K, MAISD; NaN: of fewer than two motors */
    /* workspace */
    int64_t *number;
    double *ranked;  /* (drives) */
    double *uniform; /* (drives, THERMAL_POINTS) `deviation` of motors as warm as each other */
};

/* All motors' temperatures. */
struct temperature_monitor {
    /* constants */
    int64_t period_ns; /* cycle of the readings */
    int32_t drive_count;
    int32_t cycles_per_second; /* readings in what the model takes for one sample */
    double named;        /* share of a fault's probability by which heat or a sensor is named */
    uint8_t method;      /* enum thermal_method */
    uint8_t sum_seconds; /* 1: seconds are averaged; always so with a model */
    struct temperature_drive *sensors; /* (drive_count) */
    struct motor_temperatures *motors; /* (drive_count) */
    struct thermal_monitor *model;     /* NULL without one */
    struct temperature_window window;
    /* state */
    int64_t next_ns;         /* when the next temperature cycle is due; NO_TIME: no reading yet */
    int64_t cycles;          /* temperature cycles so far */
    int64_t next_report_ns;  /* when evidence changes though nothing is received */
    int32_t cycle;           /* temperature cycles in the second that is under way */
    uint8_t second_complete; /* 1: the last cycle completed a second */
    uint8_t dirty;           /* 1: evidence may have changed since it was last reported */
    /* workspace for one sample of the model: (drives, THERMAL_POINTS) and (drives) */
    double *reading;
    struct thermal_input *input;
};

/* Temperature cycles of all motors: what a calibration is learnt from (thermal_log.c). */
struct temperature_log {
    int64_t capacity, count; /* cycles */
    int64_t cycles;          /* `cycles` of the monitor, when the last one was noted */
    /* (capacity) */
    uint8_t *second_complete; /* 1: the cycle completed a second */
    /* (capacity, drives, THERMAL_POINTS) */
    double *value_c;  /* last values, degC */
    double *mean_c;   /* over the window, degC */
    uint8_t *known;   /* 1: the mean is known, and the sensor valid */
    int64_t *held_ns; /* since the sensor's value changed */
    /* (capacity, drives, THERMAL_QUANTITIES) */
    double *second; /* means of the last complete second; NaN: no value */
};

/* ---- candump text (dbc/candump_read.c, dbc/candump_write.c) ---- */

#define CANDUMP_MAX_NAME 21  /* bytes of an interface name in a line */
#define CANDUMP_NAMES    64  /* interface names of a log that are read without Python */
#define CANDUMP_MAX_TEXT 192 /* bytes of a line that is written, its line end included */

/* What a line is. Only the first two have a frame. */
enum candump_line {
    LINE_CLASSIC = 0,
    LINE_FD = 1,
    LINE_OTHER = 2, /* dbc/candump/grammar.py decides */
    LINE_BLANK = 3,
    LINE_COMMENT = 4,
    LINE_MALFORMED = 5,
};

/* Name of a CAN interface, as it stands in a line. */
struct interface_name {
    uint8_t text[CANDUMP_MAX_NAME];
    uint8_t length; /* bytes of it; 0: no name, or one that no line can have */
};

/* Frames as columns (dbc/frames.py), one row per frame. */
struct frame_columns {
    int64_t *t_ns;
    uint32_t *can_id;
    uint8_t *flags;    /* enum frame_flag */
    uint8_t *length;   /* bytes of data; 255: more than a row keeps */
    uint8_t *data;     /* PAYLOAD_BYTES per row, 0 behind the length */
    int8_t *dlc;       /* -1: the length; else a raw length, or what a remote frame asks for */
    uint16_t *channel; /* index of its interface name */
};

/* One of them: a row of the columns. */
struct frame {
    int64_t row;
    int64_t t_ns;
    uint32_t can_id;
    uint8_t flags;
    uint8_t length;
    uint8_t *data; /* PAYLOAD_BYTES */
};

/* ---- text logs of others (dbc/text_read.c) ---- */

#define TEXT_HEADS    4096 /* different heads of a log that are read without Python */
#define TEXT_MAX_HEAD 63   /* bytes of one */

/* How the plain lines of a format look: words, a time, words that are the head, data. */
struct text_shape {
    int64_t unit_ns;      /* of the time, ns */
    int32_t words_before; /* in front of the time */
    int32_t head_words;   /* between time and data */
    int32_t marker_word;  /* which of them has to be `marker`; -1: none */
    uint8_t marker;       /* a character */
};

/* What stands between the time and the data of a line. */
struct text_head {
    uint8_t text[TEXT_MAX_HEAD];
    uint8_t length; /* bytes of it; 0: none */
};

/* ---- which inputs are valid (gateway/core/inputs.c) ---- */

/* Channels of one drive, and how good its inputs have to be; constant. */
struct drive_channels {
    double max_current_sum_a; /* phase currents whose sum is larger are not those of a motor */
    int64_t max_age_ns;       /* of a sample of current */
    int32_t first;            /* index of its first channel; the others follow */
    int32_t end;              /* index behind its last one */
    int32_t electrical[2];    /* channels of currents and voltages; -1: none */
    int32_t motion;           /* channel of Motion; -1: none */
    int32_t status;           /* channel of Status; -1: none */
};

/* What is valid of the inputs of one drive in this tick. */
struct input_status {
    double speed_rad_s;        /* of the rotor, by a fresh Motion; NaN: not known */
    uint8_t heartbeat_lost;    /* 1: its heartbeat was received and has stopped; not of inputs.c */
    uint8_t reason;            /* enum reason why currents and voltages are not valid */
    uint8_t sample_fresh;      /* 1: the newest sample is within its age limit */
    uint8_t command_valid;     /* 1: the torque command is known */
    uint8_t current_sum_fault; /* 1: the sum of the phase currents is not zero */
    uint8_t comm;              /* enum flag_state: evidence of the messages */
};

/* ---- estimates, and what the drives measure themselves (gateway/core/motion.c, plausibility.c).
 * Speeds are those of rotors unless they are called electrical. ---- */

#define CURRENT_HISTORY 8 /* samples of current that are remembered: those of a CAN FD frame */

/* What is estimated of one drive in this tick; NaN: not known. */
struct drive_estimate {
    double speed_rad_s;
    double load_nm;
    double load_sigma_nm;  /* standard deviation of the load */
    double nis;            /* normalised innovation squared, smoothed */
    double flux_ratio;     /* flux of the magnets over that of the data sheet */
    uint8_t health;        /* enum filter_health */
    uint8_t health_reason; /* enum reason why it does not track */
    uint8_t by_observer;   /* 1: from speed and torque (motion.c); 0: from currents */
};

/* Rotor of one drive, and the noise of its load observer; constant. */
struct mechanics {
    double J;         /* inertia, kg m^2, above 0 */
    double B;         /* friction, Nm s */
    double speed_var; /* variance of a measured speed, (rad/s)^2, above 0 */
    double load_rate; /* variance that the load gains per second, Nm^2/s */
};

/* Kalman filter with the states speed and load (estimators/load_observer.c). */
struct load_observer {
    double w;      /* speed, rad/s */
    double T_L;    /* load, Nm */
    double P_ww;   /* covariance, (rad/s)^2 */
    double P_wL;   /* rad/s Nm */
    double P_LL;   /* Nm^2 */
    double torque; /* of the last reading, Nm */
    double nis;    /* normalised innovation squared of the last reading */
    double spread; /* its slow mean: variance of the errors over what P says */
};

/* Measured speed and torque of one drive beside its estimate. */
struct motion {
    struct mechanics mechanics;    /* constant */
    double pole_pairs;             /* constant, above 0 */
    struct load_observer observer; /* of the last reading */
    double load_nm;                /* load that was used in the tick before; NaN: none */
    double offset_nm;              /* what is left of the last difference between two sources */
    int64_t reading_ns;            /* stamp of the last reading */
    int64_t readings;              /* since the observer started */
    int64_t unlocked_ns;    /* for how long the rotor has turned and the filter not found it */
    int64_t disagree_ticks; /* in a row that measured and estimated speed have disagreed */
    uint8_t started;        /* 1: there was a reading */
    uint8_t aliasing;       /* 1: too few samples of current per revolution for the filter */
    uint8_t by_observer;    /* 1: `load_nm` came from the observer */
    uint8_t implausible;    /* 1: the input cannot be what it seems */
};

/* Currents of one drive beside its Motion. */
struct plausibility {
    /* constants */
    double torque_per_a;   /* Nm per A along q, at the flux of the data sheet */
    double rated_a;        /* rated current */
    double rated_nm;       /* rated torque */
    double least_change_a; /* a current that should have changed by more is repeated */
    /* repeated currents */
    double current[CURRENT_HISTORY][2]; /* alpha, beta of the last samples, A, a ring */
    uint64_t samples;                   /* how many there were */
    int64_t repeats;                    /* samples in a row that equal the one before */
    int64_t block_repeats;              /* that equal the one CURRENT_HISTORY before */
    double repeated_s;                  /* time in `repeats` */
    /* angle of the current against the measured one */
    double _Complex base;    /* mean unit vector of the current in the frame of the rotor */
    double deviation;        /* of late from `base`, rad */
    int64_t learnt;          /* readings in `base`, up to LEARN */
    int64_t angle_ns;        /* stamp of the last reading that was compared */
    int64_t angle_fitted_ns; /* stamp of the last one that fitted */
    /* readings in a row that do not fit */
    int64_t angle_misfits;
    int64_t torque_misfits;
    int64_t excess_misfits; /* more torque than the currents can make */
    int64_t load_misfits;
    int64_t motion_misfits; /* Motion stood still */
    /* Motion as it last changed */
    double speed;       /* as sent */
    double torque;      /* as sent, Nm */
    double own_speed;   /* estimated then; NaN: not known */
    double command;     /* torque command then, Nm */
    int64_t changed_ns; /* stamp of it */
    /* result */
    int64_t implausible_until_ns;
    uint8_t restart; /* 1: the filter has to start anew at the end of it */
};

/* What motion.c and plausibility.c work on: records of n drives, and constants of all. */
struct motion_monitor {
    const struct receiver *receiver;
    struct input_status *inputs;
    struct drive_estimate *estimates;
    struct filter *filters;
    const struct acquisition *chords;
    struct current_calibration *sensors;
    struct rotor *rotors;
    struct motion *motions;
    struct plausibility *checks;
    double *others;          /* (n, n) measured speeds of all drives: a row for each tick in which
                                Motion of some drives changed last */
    int64_t *noted;          /* (n,) the row of every drive; below n */
    uint8_t *taken;          /* (n,) workspace */
    double max_w_e;          /* electrical speed beyond which samples are too few, rad/s */
    double turning_w_e;      /* electrical speed beyond which a filter finds its rotor, rad/s */
    double fade;             /* share of `offset_nm` that is left after a tick */
    double period_s;         /* between two samples of current */
    double dt;               /* sub-step of samples, s */
    int64_t motion_cycle_ns; /* between two Motion, at least 1 */
    int64_t tick_ns;         /* period of the loop */
    int64_t n;
};

/* ---- Adhesion (gateway/core/loads.c, adhesion.c). Loads and torques are per unit of rated torque;
 * NaN: not known. ---- */

/* What is found and remembered of the load of one drive. */
struct drive_load {
    double load;             /* in the direction of the train; 0: not known */
    double sigma;            /* its standard deviation, as estimated; 0: not known */
    double command_ratio;    /* torque command over the largest of all drives, */
    double asked_ratio;      /* the same, obeyed or not; RATIO_FLOOR or more */
    double p_response;       /* probability of a loss by its own command */
    double last_speed;       /* of the tick before, rad/s; NaN unless the drive is judged alone */
    double last_spin_up;     /* torque that accelerated the rotor in the tick before */
    double regripped_s;      /* s yet for its own slip control to hold it back; 0: it does not */
    int64_t flagged_ns;      /* last tick with its adhesion flag bad; NO_TIME: none */
    int64_t known_since_ns;  /* NO_TIME: its load is not known */
    uint8_t derating_active; /* 1: its flag is, or was just now, bad: it takes back its torque */
    uint8_t response_valid;  /* 1: `p_response` means something */
    uint8_t severe_loss;     /* 1: carries so little that noise is not the cause */
    uint8_t by_observer;     /* 1: the load is the observer's */
};

/* Everything that judges adhesion; `adhesion_reset` makes one that remembers nothing. */
struct adhesion {
    /* constants */
    const struct flag_rules *rules;
    struct vb_priors priors;
    double tick_s;
    int32_t iterations; /* of the detector `vb` */
    int32_t n;          /* drives */
    /* of every drive, (n,) */
    struct rotor *rotors;
    struct rotor_inputs *rotor_inputs;
    struct command_response *responses; /* load and command in the direction of the motor */
    struct load_ratio *response_ratios; /* load over the drive's own command, as learnt */
    struct load_ratio *ratios;          /* load over that of the others, as learnt */
    struct load_observation *observed;  /* workspace */
    struct drive_load *loads;
    /* what the detector is given: loads as if the drives were equal and fully commanded */
    double *normalised;
    double *sigma;     /* standard deviation of a healthy drive's around the common one */
    uint8_t *known;    /* 1: the load is known */
    uint8_t *compared; /* 1: known, and a measure for others */
    /* what it finds; fused with the responses in place */
    double *loss_probability;
    uint8_t *loss_known; /* 1: `loss_probability` means something */
    uint8_t *may_learn;  /* 1: the drive certainly adheres */
    double *workspace;   /* 5 n numbers */
    /* state */
    struct load_spread response_spread; /* of loads over commands */
    struct load_spread spread;          /* of loads over the common one */
    struct switching *switching;        /* NULL: another detector compares the drives */
    struct flag common_mode;            /* all drives have lost adhesion at once */
    int64_t learn_ns;                   /* next time that ratios are learnt; NO_TIME: at once */
    int64_t flagged_ns;                 /* last tick with any adhesion flag bad; NO_TIME: none */
    double common;                      /* load that adhering drives share, by the detector */
    double common_smoothed;             /* the same, smoothed */
    uint8_t comparable;                 /* 1: drives carry enough to be compared */
};

/* ---- Estimates by the filters (gateway/core/estimate.c) ---- */

/* What is remembered of one drive beside its filter. */
struct filter_track {
    double best_sigma_nm;   /* standard deviation of the load when it was known best of late */
    double load_nm;         /* after the last tick with samples, at the flux of the data sheet */
    double load_change_nm;  /* by how much it had changed in that tick */
    double spread;          /* error of the load over its standard deviation by P: learnt */
    int64_t spread_ticks;   /* that it was learnt from */
    double flux_unsure;     /* what the chords say the flux is off by and R_s may explain, of it */
    int64_t diverged_ns;    /* since when the drive is reported as diverged; -1: it is not */
    int64_t disagree_ticks; /* in a row that the chords have contradicted the filter */
    uint8_t silent;         /* 1: no samples in this tick */
};

/* The filters of n drives; `estimator_reset` makes one that knows nothing of them. */
struct estimator {
    /* constants, of every drive, (n,) */
    const struct pmsm *motors;
    const struct filter_noise *noise;
    const double *rated_a;  /* rated current, A, above 0 */
    const double *rated_nm; /* rated torque, Nm */
    /* constants of all */
    struct acquisition_limits limits;
    struct filter_settings settings;
    double tick_s;
    int32_t n; /* drives */
    /* of every drive, (n,) */
    struct filter *filters;
    struct acquisition *chords;
    struct current_calibration *sensors;
    struct filter_track *tracks;
    struct filter_sample *samples; /* of the last tick; room for as many as the receiver's */
};

/* ---- frames from a socket (dbc/socketcan.c) ---- */

/* Flags of a frame; dbc/frame.py has them from here. */
enum frame_flag {
    FRAME_EXTENDED = 1,
    FRAME_REMOTE = 2,
    FRAME_ERROR = 4,
    FRAME_FD = 8,
    FRAME_BRS = 16,
    FRAME_ESI = 32,
    FRAME_TX = 64, /* sent by the node that recorded it; else received, or not known */
};

/* struct canfd_frame; of struct can_frame (linux/can.h) 8 bytes of data are there. */
struct socket_frame {
    uint32_t id;        /* with three flags above it */
    uint8_t length;     /* bytes; any number may come */
    uint8_t flags;      /* of CAN FD */
    uint8_t reserved;   /* nothing */
    uint8_t raw_length; /* of a classic frame of 8 bytes: its DLC, 9 to 15; else 0 */
    uint8_t data[PAYLOAD_BYTES];
};

/* Room for one message: struct iovec. */
struct socket_vector {
    struct socket_frame *frame;
    size_t bytes;
};

/* struct msghdr of recvmsg(2). */
struct socket_header {
    uint8_t *name;
    uint32_t name_size;
    struct socket_vector *vector; /* one */
    size_t vectors;
    uint8_t *control;    /* aligned as a pointer is */
    size_t control_size; /* bytes: room before, used after the call */
    int32_t flags;       /* MSG_TRUNC and others */
};

/* struct mmsghdr of recvmmsg(2). */
struct socket_message {
    struct socket_header head;
    uint32_t size; /* bytes that were received */
};

/* Two clocks at one instant, ns. */
struct socket_clock {
    int64_t real_ns;    /* of the kernel's stamps */
    int64_t now_ns;     /* monotonic */
    int64_t max_age_ns; /* no frame has waited for longer */
};

struct socket_counts {
    int64_t frames;     /* rows */
    int64_t malformed;  /* messages that are no CAN frames */
    int64_t errors;     /* error frames among the rows */
    int64_t dropped;    /* frames that the kernel has dropped since the last call */
    int64_t drops_seen; /* its counter of them, 32 bits, which wraps */
};

/* ---- what speaks against all drives at once (gateway/core/integrity.c) */

/* Missed ticks, frames lost unread, a second gateway. Times are NO_TIME before any. */
struct integrity {
    /* constants */
    int64_t overrun_hold_ns;  /* an overrun is reported for so long */
    int64_t lost_hold_ns;     /* lost frames count against adhesion for so long */
    int64_t intruder_hold_ns; /* flags are unknown for so long after an intruder's last frame;
                                 INT64_MAX: until a restart */
    uint8_t authenticated;    /* 1: receivers can tell the gateway's frames from an intruder's */
    uint8_t stop_on_intruder; /* 1: the gateway falls silent then */
    /* notes of the driver for the next tick */
    int64_t missed_ticks; /* skipped before it */
    int64_t lost_frames;  /* dropped unread since the last one */
    uint8_t watching;     /* 1: frames with the gateway's identifiers can only be somebody else's */
    /* state */
    int64_t now_ns;          /* of the last tick */
    int64_t deadline_misses; /* ticks that were skipped, all together */
    int64_t late_in_a_row;   /* ticks in a row before which others were skipped */
    int64_t overrun_ns;      /* last of them */
    int64_t lost_ns;         /* last tick before which frames were lost */
    int64_t intruder_ns;     /* last tick with an intruder's frames */
    uint8_t intruder; /* 1: there was one. Latched: receivers cannot tell two senders apart */
    uint8_t silent;   /* 1: nothing is sent any more */
    uint8_t mute;     /* 1: this tick's frames are not sent: it was silent before */
};

/* ---- ticks as a report keeps them (gateway/core/tick_log.c) ---- */

/* Of the whole set. */
struct tick_row {
    int64_t t_ns;
    double bus_load_percent; /* NaN: not known */
    struct train_status train;
};

/* Of one drive; NaN: not known. */
struct drive_row {
    struct drive_status status;
    double degradation_k_h;
    double degradation_sigma_k_h;   /* its standard deviation */
    double hours_to_limit;          /* h, until the motor is limit_k warmer than the others */
    double celsius[READING_POINTS]; /* degC, of a reading that came in this tick */
};

/* Its rows, in the order of the ticks. */
struct tick_log {
    struct tick_row *ticks;   /* (capacity) */
    struct drive_row *drives; /* (capacity, drives) */
    int64_t capacity, count;  /* ticks */
    double limit_k;           /* K that a motor may grow warmer than the others */
};

#define TABLE_MAX_WORD     23
#define TABLE_MAX_DECIMALS 4
#define TABLE_MAX_FIELD 24 /* bytes of one with its comma: a word, or 16 digits, point and sign */
#define TABLE_MAX_HEAD  48 /* bytes of time, node and line end */

/* A word of a table. */
struct table_word {
    uint8_t text[TABLE_MAX_WORD];
    uint8_t length; /* bytes of it */
};

/* A column of a table: numbers, or words by their codes. */
struct table_column {
    const double *value;            /* (rows); NaN: an empty field */
    int32_t decimals;               /* 1 to TABLE_MAX_DECIMALS */
    const uint8_t *code;            /* (rows); NULL: a column of numbers */
    const struct table_word *words; /* by code */
};

/* A table with a row for each tick and each of its drives. */
struct table {
    const int64_t *t_ns;  /* (ticks) */
    const int32_t *nodes; /* (drive_count) */
    const struct table_column *columns;
    int32_t drive_count;
    int32_t column_count;
};

/* ---- the gateway (gateway/core/tick.c) ---- */

/* What comes next in a tick. */
enum tick_stage {
    STAGE_RECEIVE = 0, /* a new tick */
    STAGE_DETECT = 1,  /* a detector that is not in the core, then `finish_tick` */
};

/* All records of a gateway, by station, and how its ticks go. */
struct gateway {
    struct receiver *receiver;
    struct bus_load *load;
    struct integrity *integrity;
    const struct drive_channels *channels;
    struct input_status *inputs;
    struct estimator *estimator;
    struct drive_estimate *estimates;
    struct motion_monitor *motion;
    struct adhesion *adhesion;
    struct temperature_monitor *temperatures;
    const struct flag_rules *rules;
    struct train_inputs *train_inputs;
    struct flag_inputs *flag_inputs;
    struct drive_evidence *evidence;
    struct drive_status *status;
    struct train_status *train;
    struct transmitter *transmitter;
    /* constants */
    int64_t period_ns;
    int32_t drive_count;
    uint8_t is_translated; /* 1: frames come from a translator; it counts the load of the bus */
    uint8_t detects;       /* 1: the detector is the core's own */
    /* result of a run */
    struct tx_frame *sent; /* frames of its ticks */
    int64_t sent_capacity; /* most that fit: at least those of a tick */
    int64_t sent_count;
    double *peak;         /* (drive_count) largest probability of loss; NaN: none */
    struct tick_log *log; /* of its ticks; NULL: none is wanted */
    /* state */
    uint8_t stage;   /* enum tick_stage */
    uint8_t begun;   /* 1: there was a tick */
    uint8_t changed; /* 1: the last tick changed a flag */
};

/* ---- the paper's detectors, beside the product's own ---------------------------------------- */

/* Factors q(mu, Lambda) q(pi) of variational Bayes, or their prior, in one dimension. Component 0
 * adheres, component 1 is lost. Unit: that of the loads. */
struct paper_vb_factors {
    double m[2];     /* mean of mu_k */
    double beta[2];  /* weight of m_k, in drives */
    double W_inv[2]; /* square of the unit; inverse of the scale W_k of Lambda_k */
    double nu[2];    /* degrees of freedom of Lambda_k */
    double alpha[2]; /* weight of the component, in drives */
};

/* Lower bound of one iteration of variational Bayes. */
struct paper_vb_bound {
    double indicated; /* after the update of q(I) */
    double updated;   /* after the update of q(pi, mu, Lambda) */
};

/* Factors of variational message passing, or their prior; components and unit the same. */
struct message_passing_factors {
    double m[2];     /* mean of mu_k */
    double tau[2];   /* precision of mu_k */
    double a[2];     /* shape of Lambda_k */
    double b[2];     /* square of the unit; rate of Lambda_k */
    double alpha[2]; /* weight of the component, in drives */
};

/* Nodes of message passing: indicators, share of lost drives, means, precisions. */
enum message_passing_node { NODE_I = 0, NODE_PI = 1, NODE_MU = 2, NODE_LAMBDA = 3 };

/* ---- a rival of the thermal monitor: an extended Kalman filter ------------------------------ */

/* Thermal model of one point: one lump, dT/dt = c (I^2 + g w^2) - xi (T - T_out). */
struct lumped_model {
    double gain;        /* K/(A^2 s), c */
    double loss;        /* 1/s, xi */
    double speed_share; /* A^2 s^2, g */
    double offset;      /* K, of the sensor */
    double unrest;      /* K^2, variance of what the model leaves out */
    double noise;       /* K^2, variance of a reading */
    double usual;       /* degC, mean reading */
};

/* How the filter is run. */
struct lumped_tuning {
    double step_s;      /* s, length of a step of the inputs */
    double walk;        /* variance by which the logarithms of gain and loss walk per sample */
    double prior_sigma; /* standard deviation of these logarithms at the start */
};

/* ---- Losses of adhesion by a model with a memory (estimators/detect/switching.c) ------------- */
/* Symbols and equation numbers: docs/switching.md. Torques per unit of rated torque, in the
 * direction of the train. */

#define SWITCHING_PAST  10 /* steps within which the scatter of a load shows: 0.1 s */
#define SWITCHING_KEPT  6  /* hypotheses that are kept from step to step */
#define SWITCHING_TRIED 48 /* hypotheses that are weighed in one step: eight from each */

/* Load of a drive over the demand of the train while it adheres: r + u. */
struct switching_ratio {
    double r;    /* for good: axle load, wheel, magnet */
    double u;    /* that comes and goes: curves */
    double v_rr; /* variance of r */
    double v_ru; /* covariance */
    double v_uu; /* variance of u */
};

/* One drive under one hypothesis. */
struct switching_drive {
    double adhering;               /* probability that it adheres, */
    double lost;                   /* that it has lost adhesion, */
    double neither;                /* that its load means nothing; their sum is 1 */
    double fresh;                  /* share of `lost` whose c is new in this step, */
    double fresh_neither;          /* and of `neither` */
    double c;                      /* load over the demand unless it adheres */
    double v_c;                    /* variance of c */
    double less;                   /* probability that c is a share which a lost drive may carry */
    double precision;              /* what its load tells of the demand: 1 / variance, */
    double shift;                  /* and mean / variance */
    struct switching_ratio now;    /* if it adheres */
    struct switching_ratio before; /* if it does not: as it was while it did */
};

/* One hypothesis of how the demand and all drives have come to what they are. */
struct switching_hypothesis {
    double log_weight; /* logarithm of its probability */
    double m;          /* demand */
    double s;          /* its change in a step */
    double v_mm;       /* variance of m */
    double v_ms;       /* covariance */
    double v_ss;       /* variance of s */
};

/* What is known of the load of one drive. */
struct switching_load {
    double load;
    double gain;    /* noise is that which is learnt times (1 + gain): more in a scaled load */
    double error;   /* standard deviation of what is known to be off beside noise */
    double sigma;   /* standard deviation of the load as estimated: its noise until it is learnt */
    uint8_t known;  /* 1: `load` is a number */
    uint8_t apart;  /* 1: its wheel runs apart from the others and is no measure for them */
    uint8_t unsure; /* 1: its wheel may not adhere: nothing is learnt from it */
    uint8_t source; /* which estimate the load is of two: each has its own noise */
};

/* How far loads lie from what is expected of them. */
struct switching_noise {
    double variance; /* as learnt */
    double lag;      /* standard deviation more while the demand moves */
    double learnt_s; /* for how long `variance` has been learnt */
    double lasting;  /* mean error of late, in standard deviations: what lasts is no noise */
    double scatter;  /* two of three changes of the error within SWITCHING_PAST steps are smaller */
    double past[SWITCHING_PAST]; /* errors of these steps, */
    int32_t at;                  /* place of the oldest, */
    int32_t count;               /* how many there are */
    uint8_t source;              /* of the loads that this was learnt from */
};

/* Everything; `switching_reset` makes one that knows nothing. */
struct switching {
    int32_t n;                               /* drives */
    int32_t every;                           /* ticks in a step of 10 ms, at least 1 */
    int32_t ticks;                           /* since the last step */
    int32_t kept;                            /* hypotheses */
    int32_t contradicted;                    /* steps in a row in which most loads meant nothing */
    struct switching_load *loads;            /* (n,) input */
    struct switching_noise *noises;          /* (n,) */
    struct switching_hypothesis *hypotheses; /* (SWITCHING_KEPT,), the first `kept` */
    struct switching_drive *drives;          /* (SWITCHING_KEPT, n) */
    struct switching_hypothesis *trials;     /* (SWITCHING_TRIED,) workspace */
    struct switching_drive *trial_drives;    /* (SWITCHING_TRIED + 1, n) workspace */
    double *adhering;                        /* (n,) probabilities of all hypotheses together */
    double *lost;                            /* (n,) */
    double demand;                           /* mean of all hypotheses */
};

#endif
