/* Records of the core: one line per field, with unit and meaning.
 *
 * The compiler, cffi and NumPy (dbc/records.py) all read this file, so each layout is defined once.
 * Only `#define` of a number, `enum` and `struct` are allowed: cffi parses nothing else.
 * Longer than other files because it holds every record of the core. */
#ifndef TRACTION_RECORDS_H
#define TRACTION_RECORDS_H

#include <stddef.h>
#include <stdint.h>

#define E2E_WINDOW    5 /* receiver cycles that the state machine evaluates */
#define E2E_MAX_DELTA 3 /* largest counter step between accepted frames: two in a row may be lost */

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

/* State of the receiver of one message; `e2e_reset` sets it to nothing received. */
struct e2e_state {
    int16_t counter; /* of the last frame with a good checksum; -1: none yet */
    uint16_t step;   /* counter steps from the frame before to that frame: 1 to a full turn */
    uint8_t missed;  /* frames lost just before the last accepted one, by its counter */
    uint8_t state;   /* enum e2e_sm_state */
    uint8_t window[E2E_WINDOW]; /* results of the last cycles, a ring (enum e2e_check_status) */
    uint8_t next;               /* index in `window` of the oldest result */
};

/* Flags (gateway/core/flags.c), and the numbers that are published with them. */

#define FLAG_KINDS 5         /* of a drive: enum flag_kind */
#define NO_TIME    INT64_MIN /* value of a time stamp or an age that does not exist */

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
        3, /* evidence only: the earlier evidence stands, and no flag changes because of it */
};

/* Reason why a value or a flag is unknown; numbers as in the DBC. Priorities: `reason_rank`. */
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

/* Sensor that has a fault. */
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
    int64_t good_ns;  /* ns, from unknown to good */
    int64_t raise_ns; /* ns, from unknown or good to bad */
    int64_t clear_ns; /* ns, from bad to good */
};

/* Times and thresholds by which evidence changes flags; constant. */
struct flag_rules {
    struct flag_timing timing[FLAG_KINDS]; /* by enum flag_kind */
    struct flag_timing
        severe; /* of the adhesion flag on a severe loss: too much load is missing for noise */
    double raise_probability; /* probability of lost adhesion from which on evidence is bad */
    double clear_probability; /* probability up to which it is good; between: FLAG_UNCHANGED */
    int64_t tick_ns;          /* period of the loop */
};

/* One flag: what is sent, and the evidence that may change it. */
struct flag {
    int64_t
        since_ns;  /* stamp when the evidence last changed; each tick of FLAG_UNCHANGED delays it */
    uint8_t state; /* enum flag_state */
    uint8_t evidence; /* enum flag_state: the last evidence other than FLAG_UNCHANGED */
};

/* Results of the preceding stations for one drive in this tick. */
struct flag_inputs {
    double loss_probability; /* probability of lost adhesion; outside 0 to 1: not known */
    double speed_rad_s;      /* speed of the rotor, rad/s; NaN: not known */
    double load_nm;          /* load, Nm; NaN: not known */
    double load_sigma_nm;    /* standard deviation of the load, Nm; NaN: not known */
    double nis;              /* normalised innovation squared, smoothed; NaN: not known */
    double mixed_c;    /* mean temperature of the motor's valid sensors, degC; NaN: not known */
    double maisd_k;    /* largest MAISD of all points, K; NaN: not known */
    double rate_k_h;   /* rate of degradation, K/h; NaN: not known */
    int64_t jumps;     /* number of temperature steps so far */
    int64_t sample_ns; /* stamp of the newest sample of current, ns; negative: none */
    int64_t temperature_ns;    /* stamp of the last temperature reading, ns; NO_TIME: none */
    uint8_t input_reason;      /* enum reason why currents and voltages are not valid */
    uint8_t input_implausible; /* 1: the input is implausible (motion.c) */
    uint8_t current_sum_fault; /* 1: the phase currents do not sum to zero */
    uint8_t comm;              /* enum flag_state: evidence of the drive's communication */
    uint8_t health;            /* enum filter_health */
    uint8_t health_reason;     /* enum reason why the filter is not tracking */
    uint8_t loss_known;        /* 1: `loss_probability` is valid */
    uint8_t withdrawn;         /* 1: the drive is off and rolls along: its flag is withdrawn */
    uint8_t may_spin_up;       /* 1: the rotor may be running away: adhesion cannot be good */
    uint8_t severe_loss;       /* 1: too much load is missing for noise: times of `severe` apply */
    uint8_t thermal;           /* enum flag_state: evidence of the temperatures */
    uint8_t sensor;            /* enum flag_state: evidence of the temperature sensors */
    uint8_t thermal_reason;    /* enum reason why `thermal` is unknown */
    uint8_t fault_class;       /* enum fault_class */
    uint8_t fault_sensor;      /* enum fault_sensor */
};

/* Inputs that are common to all drives in this tick. */
struct train_inputs {
    uint8_t integrity_reason; /* enum reason why no adhesion flag is valid, or REASON_NONE */
    uint8_t common_mode;      /* enum flag_state: all drives have lost adhesion at once */
    uint8_t silent;           /* 1: the gateway has stopped sending */
    uint8_t overrun;          /* 1: ticks were missed recently */
};

/* Evidence of one drive in this tick. */
struct drive_evidence {
    uint8_t of[FLAG_KINDS];  /* enum flag_state, by enum flag_kind */
    uint8_t adhesion_reason; /* enum reason that is sent if the adhesion flag is unknown */
    uint8_t severe_loss;     /* 1: the times of `severe` apply to the adhesion flag */
};

/* What is published of one drive. A number that is not known is NaN. */
struct drive_status {
    struct flag flag[FLAG_KINDS]; /* by enum flag_kind */
    double speed_rad_s;           /* speed of the rotor, rad/s */
    double load_nm;               /* load, Nm */
    double load_sigma_nm;         /* standard deviation of the load, Nm */
    double loss_probability;      /* probability of lost adhesion, 0 to 1 */
    double nis;                   /* normalised innovation squared */
    double mixed_c;               /* mean temperature of the motor's valid sensors, degC */
    double maisd_k;               /* largest MAISD of all points, K */
    double rate_k_h;              /* rate of degradation, K/h */
    double creep;                 /* creep of the wheel (creep.c) */
    double creep_sigma;           /* standard deviation of the creep */
    double utilisation;           /* load over rated torque, without its sign */
    double utilisation_sigma;     /* standard deviation of the utilisation */
    int64_t jumps;                /* number of temperature steps so far */
    int64_t age_ns;               /* age of the newest sample of current, ns; NO_TIME: none */
    int64_t temperature_age_ns;   /* age of the last temperature reading, ns; NO_TIME: none */
    uint8_t adhesion_reason;      /* enum reason; REASON_NONE unless the flag is unknown */
    uint8_t thermal_reason;       /* enum reason; REASON_NONE unless the flag is unknown */
    uint8_t health;               /* enum filter_health */
    uint8_t fault_class;          /* enum fault_class */
    uint8_t fault_sensor;         /* enum fault_sensor */
};

/* What is published of all drives together. */
struct train_status {
    int64_t age_ns;             /* largest `age_ns` of all drives; NO_TIME if one drive has none */
    int64_t temperature_age_ns; /* the same for `temperature_age_ns` */
    uint8_t adhesion_reason;    /* enum reason: worst `adhesion_reason` of all drives */
    uint8_t faults_reason;      /* enum reason: worst `thermal_reason` of all drives */
    uint8_t sensor;             /* enum flag_state: bad if one drive's is, else unknown if one is */
    uint8_t comm;               /* the same for the communication flags */
    uint8_t estimator;          /* the same for the estimator flags */
    uint8_t overrun;            /* enum flag_state: bad if ticks were missed recently */
    uint8_t state;              /* enum gateway_state */
    uint8_t detector;           /* number of the detector in the DBC; written once */
    uint8_t common_mode;        /* enum flag_state: bad if all drives have lost adhesion at once */
};

/* Variational Bayes (estimators/detect/variational.c). */

#define VB_MAX_STARTS 16 /* most starts, each with another drive's load as the adhering one */

/* Prior of variational Bayes; constant. */
struct vb_priors {
    double nu;             /* degrees of freedom of both precisions */
    double beta_adhering;  /* weight of the mean of adhering loads, in drives */
    double beta_lost;      /* weight of the mean of lost loads, in drives */
    double alpha_adhering; /* weight of the share of adhering drives, in drives */
    double alpha_lost;     /* weight of the share of lost drives, in drives */
};

/* Loads of healthy drives, and their answers to commands (estimators/detect/load_reference.c,
 * command_response.c). Torques are per unit of rated torque. */

/* Scatter of the loads of healthy drives, the same for all drives. */
struct load_spread {
    double spread;     /* standard deviation, learnt */
    double configured; /* standard deviation at the start */
};

/* Load of one adhering drive relative to the common load. */
struct load_ratio {
    double ratio;    /* load over the common load */
    double variance; /* variance of `ratio` */
    double residual; /* load over `ratio` minus the common load, last observation */
    uint8_t seen;    /* 1: there was an observation */
    uint8_t taught;  /* 1: the last observation changed `ratio` */
};

/* One observation of the load of one drive. */
struct load_observation {
    double load;     /* load of the drive */
    double common;   /* common load of the adhering drives, or the command of this drive */
    uint8_t known;   /* 1: `load` and `common` are known */
    uint8_t healthy; /* 1: the drive certainly adheres */
};

/* Load and command of one drive, both positive in the direction of its motor. */
struct command_response {
    double load;        /* load, with the torque that accelerates the rotor with its train */
    double braked_load; /* `load` if friction brakes slow the train; equal to `load` in traction */
    double
        acceleration_torque; /* torque on the rotor's inertia, larger of two ticks; 0: not needed */
    double command;          /* torque command */
    double previous_command; /* torque command before that */
    double command_age_s;    /* time since the command was sent, s */
    double deficit_s;        /* time for which too little load has been carried, s; 0: no deficit */
    double missing;          /* what is missing of the least load; this and the next: if valid */
    double missing_sigma;    /* standard deviation of `missing` */
    uint8_t usable;          /* 1: load and command are known */
    uint8_t braked;          /* 1: friction brakes are assumed to explain the missing load */
};

/* ---- signals: where their bits are and what they mean (dbc/decode.c, dbc/encode.c) ---- */

#define MAX_LISTED_BITS 8 /* bits of the selector of a listed message (`struct message`), at most */
#define PAYLOAD_BYTES   64 /* bytes of a row of payload; zeros follow the data of the frame */

/* Validity of a signal, found from its raw value before scaling. */
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

/* One signal of a message; constant. A key is a raw value with its sign bit inverted, so that keys
 * of signed and of unsigned signals are ordered alike. */
struct signal {
    uint64_t mask;        /* ones in as many bits as the signal has */
    uint64_t sign;        /* its sign bit; 0: the signal is unsigned, or a float */
    uint64_t key_min;     /* lowest key in range */
    uint64_t key_max;     /* highest key in range */
    uint64_t key_none;    /* key of the not-available code, if `has_none` */
    uint64_t valid_first; /* first key of a run that one comparison finds valid */
    uint64_t valid_count; /* length of that run; keys outside of it can be valid, too */
    uint64_t start;       /* its start value, raw bits */
    double scale;         /* physical unit per raw step; not 0 */
    double offset;        /* physical value of raw 0 */
    double float_min;     /* lowest physical value in range; floats only */
    double float_max;     /* highest physical value in range; floats only */
    uint32_t first_range; /* index of the first `struct mux_range` that selects it */
    uint16_t range_count; /* number of these ranges */
    uint16_t multiplexer; /* index in the message of the signal that selects it */
    uint16_t mux_depth;   /* number of selectors above it; 0: it is in every frame */
    uint8_t first_byte;   /* index of the first of the eight bytes that hold it, 0 to 56 */
    uint8_t shift;        /* number of bits below it in these eight bytes, 0 to 63 */
    uint8_t ninth_bits;   /* number of its bits in the byte after these, 0 to 7 */
    uint8_t big_endian;   /* byte order: 1 Motorola, 0 Intel */
    uint8_t type;         /* enum signal_type */
    uint8_t has_none;     /* 1: it has a not-available code */
    uint8_t saturates;    /* 1: the ends of its range mean "or beyond" */
};

/* One message; constant. It is listed if it has one selector, of at most MAX_LISTED_BITS bits, and
 * at most 64 signals: the signals of a frame are then looked up by the selector's bits. */
struct message {
    uint32_t first_signal;  /* index of its first `struct signal`; the others follow */
    uint32_t first_present; /* index in `present` of the entry for the selector's value 0 */
    uint16_t signal_count;  /* number of its signals */
    uint16_t mux_depth;     /* largest `mux_depth` of its signals; 0: not multiplexed */
    uint16_t selector;      /* index in the message of its one selector, if `is_listed` */
    uint16_t is_listed;     /* 1: the message is listed */
};

/* Range of values of a selector, both ends included; constant. */
struct mux_range {
    int64_t low;  /* lowest raw value */
    int64_t high; /* highest raw value */
};

/* A message set; constant. Made by dbc/codec_tables.py. */
struct codec {
    const struct message *messages; /* (message_count) messages; the index of one is its number */
    const struct signal *signals;   /* signals of all messages, one message after the other */
    const struct mux_range *mux_ranges; /* ranges that select signals; those of one are adjacent */
    const uint64_t *present;            /* signals in a frame of a listed message, one bit each */
    int32_t message_count;              /* number of `messages` */
    int32_t width; /* columns of a decoded row: most signals that one message has */
};

/* ---- Temperatures of the motors, and their thermal model ---- */

#define THERMAL_POINTS 3 /* points with a sensor: stator winding, drive end, non-drive end */
#define READING_POINTS 4 /* these points, then the ambient temperature */
#define THERMAL_LUMPS  5 /* heat capacities of a motor model: enum thermal_lump */

/* Lumps, the heat capacities of a motor model (estimators/thermal/model.c). */
enum thermal_lump {
    THERMAL_WINDING = 0,
    THERMAL_CORE = 1,
    THERMAL_FRAME = 2,
    THERMAL_DRIVE_END = 3,
    THERMAL_OTHER_END = 4,
};

/* Thermal model of one motor; constant. Rates, not heat capacities: only rates are observable. */
struct thermal_parameters {
    double a;                        /* K/(s A^2), copper loss of the winding at 60 degC */
    double k_w;                      /* 1/s, winding to core */
    double k_c;                      /* 1/s, core from winding */
    double e_1;                      /* K/rad, iron loss, linear in the speed */
    double e_2;                      /* K s/rad^2, iron loss, quadratic in the speed */
    double g_c;                      /* 1/s, core to frame */
    double g_f;                      /* 1/s, frame from core */
    double h_0;                      /* 1/s, frame to the air at standstill */
    double h_1;                      /* 1/rad, increase of h_0 per rad/s of speed */
    double k_d;                      /* 1/s, drive end from frame */
    double f_d;                      /* K/rad, friction of the drive end */
    double b_d;                      /* 1/s, drive end to the air */
    double k_n;                      /* 1/s, non-drive end from frame */
    double f_n;                      /* K/rad, friction of the non-drive end */
    double b_n;                      /* 1/s, non-drive end to the air */
    double offset_k[THERMAL_POINTS]; /* K, offset of each sensor */
};

/* Inputs of a motor's thermal model. */
struct thermal_input {
    double current_square; /* A^2, of the current's amplitude */
    double speed;          /* rad/s, of the rotor, without sign */
    double ambient;        /* degC */
};

#define STEP_WINDOW_MAX 1024 /* most samples of before, after and settled together */

/* Settings of the step detector; constant. */
struct step_config {
    double step_k;   /* K, a larger difference of the medians is a step; 0: no steps are detected */
    double back_k;   /* K, a smaller offset counts as none */
    double drift_k;  /* K per sample, largest rate at which `home_k` follows `level_k` */
    int32_t before;  /* samples of the level before a step */
    int32_t after;   /* samples of the readings that show a step */
    int32_t settled; /* samples until a step is measured: a burst is over by then */
};

/* Step detector of one sensor; `step_reset` sets it to nothing known. */
struct step_state {
    double offset_k; /* K, offset of the sensor: sum of its steps */
    double level_k;  /* K, last known median of the residuals; NaN: none, or too long ago */
    double home_k;   /* K, level of the sensor while it has no offset; NaN: not known */
    int32_t since;   /* samples since a step that is not measured yet; -1: none */
    int32_t unseen;  /* samples since `level_k` was last measured */
};

#define MIXTURE_MAX 8 /* most components of a Gaussian mixture */

/* A Gaussian mixture of a scalar, its components in the order of their means. */
struct mixture {
    double weight[MIXTURE_MAX];   /* weights; their sum is 1 */
    double mean[MIXTURE_MAX];     /* means, in the unit of the scalar */
    double variance[MIXTURE_MAX]; /* variances, in the square of that unit */
};

/* Sigma-mixed filter of one motor (paper `thermal`); constant. */
struct sigma_mixed_config {
    double drift[THERMAL_POINTS]; /* K/s, rate of degradation of each point */
    double q[THERMAL_POINTS];     /* K^2, variance of the model's error from sample to sample */
    double r[THERMAL_POINTS];     /* K^2, variance of a reading */
    double apart[THERMAL_POINTS]; /* K, usual distance of a point from the mean of the three */
    double kappa;                 /* scaling of the sigma points */
    double mixing;    /* share of the way that the prior's common part moves to the mixed state */
    int32_t weighted; /* 1: weighted mean of the mixture; 0: plain mean, eq. (21) */
};

/* Inputs of the sigma-mixed filter for one sample. */
struct sigma_mixed_sample {
    double y[THERMAL_POINTS];       /* degC, readings; NaN: no reading */
    double settled[THERMAL_POINTS]; /* degC, where a point would settle under the inputs */
    double keep[THERMAL_POINTS];    /* share of the distance from `settled` left after the gap */
    double gap;                     /* s, time since the last sample */
};

#define IMM_HEATS         5   /* heat faults: overheating, lost cooling, two bearings, resistance */
#define IMM_MODES         9   /* no fault; one mode for each heat fault and for each sensor off */
#define IMM_DISTURBANCES  5   /* in every motor: copper, local air, fan, friction of both ends */
#define IMM_STATES        12  /* lumps K, disturbances, size of the fault K, its rate K/s */
#define THERMAL_KINDS     11  /* kinds of fault: heat faults, sensors off, loose connectors */
#define THERMAL_BLOCK_MAX 128 /* most samples of a block, and of the window of the step detector */

/* Prior of a fault of one mode when it begins. */
struct imm_fault {
    double mean_k;    /* K, mean of its size */
    double sigma_k;   /* K, standard deviation of its size */
    double creep_k_s; /* K/s, standard deviation of the rate at which it grows */
    double share;     /* share of all beginning faults that have this mode */
};

/* Settings of the interacting multiple models, for every motor; constant. */
struct imm_config {
    double block_s;                 /* s, duration of a block */
    double begin_per_s;             /* 1/s, rate at which a fault begins */
    double end_per_s;               /* 1/s, rate at which a fault ends */
    double memory_s;                /* s, time constant of disturbances and of a sensor's creep */
    double unsure;                  /* relative error of the model in a lump's own heat exchange */
    double walk_k;                  /* K, random walk of the size of a heat fault per block */
    double walk_share;              /* random walk of a size per block, as a share of the size */
    double own_k;                   /* K, process noise of a lump per square root of a minute */
    double wide_k;                  /* K, additional standard deviation of an outlying block */
    double unsteady;                /* relative fluctuation of a fault's heat within a block */
    double walk_sensor_k;           /* K, random walk of a sensor's error per block */
    double sigma[IMM_DISTURBANCES]; /* standard deviations of the disturbances */
    double benign_k[IMM_MODES - 1]; /* K, size below which each kind of fault is benign */
    double shown_k;                 /* K, least rise of some reading for a heat fault */
    double ambiguous;     /* share of a probability that heat and a sensor give each other */
    double ambiguous_low; /* the same share if the sensor reads low */
    struct imm_fault fault[IMM_MODES]; /* prior of each mode; that of the first mode is not used */
    int32_t modes; /* number of modes in use: IMM_MODES, or 1 for no fault at all */
};

/* Effect of disturbances and faults on the lumps, for the inputs of one block. */
struct imm_surroundings {
    double rates[THERMAL_LUMPS][THERMAL_LUMPS];     /* 1/s, system matrix */
    double pushes[THERMAL_LUMPS][IMM_DISTURBANCES]; /* K/s of a lump per unit of each disturbance */
    double heats[IMM_HEATS][THERMAL_LUMPS];         /* K/s of a lump per K of each heat fault */
    double rise_k;                                  /* K, temperature of the frame above the air */
};

/* State of one motor's interacting models: one filter for each mode. */
struct imm_state {
    double mode[IMM_MODES];                        /* probabilities of the modes; their sum is 1 */
    double mean[IMM_MODES][IMM_STATES];            /* state vectors of the filters */
    double cov[IMM_MODES][IMM_STATES][IMM_STATES]; /* their covariances */
};

/* Sums of a motor's inputs over part of a block. */
struct thermal_sums {
    double current_square; /* A^2, square of the current's amplitude */
    double speed;          /* rad/s, speed of the rotor without its sign */
    double cooling;        /* K/s, cooling of the frame by the air */
    double copper;         /* K/s, heating of the winding by copper loss */
    double rise;           /* K, temperature of the frame above the air */
    double count;          /* number of samples */
};

/* Which motors are cut out: they turn without current while another is driven; constant. */
struct cut_out_config {
    double share; /* share of the largest mean squared current: a motor with less is cut out */
    double driven_square; /* A^2, least mean squared current of a motor that is driven */
    double weight;        /* weight of a sample in the means */
};

/* Current of one motor; all zero when nothing is known. */
struct motor_current {
    double square;   /* A^2, mean of the squared amplitude over the last half minute */
    int32_t idle;    /* samples in a row without current while another motor was driven */
    uint8_t cut_out; /* 1: the motor turns without current */
};

/* Bursts of one sensor, which may reach into the next block. */
struct thermal_burst {
    double level_k; /* K, level from which they depart; NaN: not known */
    int32_t away;   /* readings since the sensor left it; 0: it is there */
};

/* Constants of one motor, learnt from fault-free runs. */
struct thermal_motor_config {
    struct thermal_parameters model; /* thermal model of the motor */
    double centre_k[THERMAL_POINTS]; /* K, residual beside the other motors' */
    double noise_k[THERMAL_POINTS];  /* K, standard deviation of a single reading */
    double block_noise_k;            /* K, standard deviation of a block's median */
    double inflation;                /* factor on the filters' standard deviations: at least 1 */
    uint8_t unexplained; /* 1: even so the model does not fit: it does not judge the motor */
};

/* Settings of a train's thermal monitor; constant. */
struct thermal_config {
    struct imm_config imm;    /* settings of the filters for faults */
    struct step_config steps; /* settings of the step detectors */
    double dt_s;              /* s, time from one sample to the next */
    double gap_s;             /* s without inputs after which a motor's model starts again */
    double duty_speed;        /* rad/s, mean speed in them */
    double duty_cooling;      /* K/s, mean cooling of the frame */
    double duty_copper;       /* K/s, mean heating of the winding */
    double settles_k
        [THERMAL_LUMPS]; /* K, settled rise at the point that shows most, of 1 K/s in a lump */
    double loose_share;  /* share of a loose connector's readings that are far off */
    double good_share;   /* share of a good connector's readings that are far off */
    double far_sigma;    /* standard deviations from which on a reading is far off */
    double burst_length; /* readings in a burst: they are not independent */
    double far_k;        /* K, a smaller distance in a block is not far off: heat may cause it */
    double loose_begin_per_s;      /* 1/s, rate at which a connector comes loose */
    double loose_end_per_s;        /* 1/s, rate at which a loose connector is mended */
    double learn_per_s;            /* 1/s, rate at which a fault-free motor's baseline is learnt */
    double raise_probability;      /* probability above which a fault is reported: at least 0.9 */
    struct cut_out_config cut_out; /* which motors turn without current while others are driven */
    int32_t block;                 /* samples of a block, at least 1 */
};

/* State of one motor; `thermal_motor_reset` sets it to nothing known. */
struct thermal_motor {
    double lumps[THERMAL_LUMPS]; /* degC, temperatures by the open-loop model (enum thermal_lump) */
    double unknown_s;            /* s since its inputs were last known */
    double cold_s;               /* s to drive until its model starts: it was cut out */
    double parked_s;             /* s since it last turned or had current */
    struct step_state step[THERMAL_POINTS];           /* step detector of each sensor */
    struct thermal_burst burst[THERMAL_POINTS];       /* end of each sensor's last block */
    double window[THERMAL_POINTS][THERMAL_BLOCK_MAX]; /* K, latest residuals, the newest last */
    double block[THERMAL_POINTS][THERMAL_BLOCK_MAX];  /* K, residuals of this block, less steps */
    double raw[THERMAL_POINTS][THERMAL_BLOCK_MAX];    /* K, the same residuals with steps */
    struct thermal_sums half[2]; /* sums of inputs, first and second half of this block */
    struct thermal_sums late;    /* sums over the second half of the last block */
    struct thermal_sums inputs;  /* sums from the middle of the last block to that of this one */
    double middle_k[THERMAL_POINTS]; /* K, medians of the last block; NaN: too few readings */
    double bursts[THERMAL_POINTS]; /* log odds for a loose connector by the last block; NaN: none */
    double compared_k[THERMAL_POINTS]; /* K, what others are compared with; NaN: nothing */
    double absent_s[THERMAL_POINTS];   /* s since a block had enough readings for it */
    double peers_k[THERMAL_POINTS]; /* K, median of the others' last blocks; NaN: too few others */
    double off_k[THERMAL_POINTS];   /* K, last block relative to the other motors; NaN: no others */
    double base_k[THERMAL_POINTS];  /* K, baseline learnt while there was no fault */
    double loose[THERMAL_POINTS];   /* probability of a loose connector */
    double kind[THERMAL_KINDS];     /* probability of each kind of fault, after hysteresis */
    double size_k;                  /* K, likely size of the fault */
    double log_likelihood;          /* log likelihood of the last block */
    double fault_probability;       /* probability of any fault, before hysteresis */
    struct imm_state imm;           /* filters of the modes, as of the last judged block */
    double driven_mode[IMM_MODES];  /* probabilities of the modes when `parked_s` was last 0 */
    int32_t judged;                 /* number of blocks judged so far */
    uint8_t started;                /* 1: the model runs */
    uint8_t lost;    /* 1: its inputs were unknown for too long: it has to start again */
    uint8_t held;    /* 1: a fault is reported */
    uint8_t trusted; /* 1: in the last block other motors were compared with it */
};

#define HYPOTHESIS_SIZES  11  /* sizes of a fault that are tested */
#define HYPOTHESIS_STATES 125 /* no fault, kinds times sizes, loose connectors: hypotheses.c */

/* Discrete Bayes filter over kinds and sizes of faults; constant. Rates are per sample. */
struct hypothesis_config {
    double sizes_k[HYPOTHESIS_SIZES]; /* K, ascending */
    double benign_k[IMM_MODES - 1];   /* K, least size that is a fault, of each heat and sensor */
    double begin;                     /* rate at which a fault begins */
    double end;                       /* rate at which a fault ends */
    double growth;      /* rate at which a size changes to the next larger, or smaller, one */
    double often;       /* rate at which benign dirt, draught or weather begins */
    double learn;       /* rate at which a baseline is learnt */
    double loose_end;   /* rate at which a loose connector is forgotten */
    double tail;        /* degrees of freedom of Student's t of the readings */
    double log_t;       /* logarithm of that density at its centre, for unit scale */
    double loose_share; /* share of a loose connector's readings that are off */
    double loose_k;     /* K, largest error of these readings */
};

/* Distribution of a healthy motor's residual relative to its peers; constant. */
struct hypothesis_spread {
    double sigma_k[THERMAL_POINTS];               /* K, standard deviations */
    double white[THERMAL_POINTS][THERMAL_POINTS]; /* 1/K, rows turn points into independent parts */
    double share[THERMAL_POINTS]; /* weight of a sample of each part, 1: an independent one */
};

/* State of one motor's discrete Bayes filter. */
struct hypothesis_state {
    double p[HYPOTHESIS_STATES];   /* probability of each state */
    double base_k[THERMAL_POINTS]; /* K, baseline that has been learnt */
    double kind[THERMAL_KINDS];    /* probability of each kind of fault, without benign sizes */
    double size_k;                 /* K, mean size of what is wrong, if anything is */
    double rise_k;   /* K, mean error of a sensor, if one is off; positive: it reads high */
    int32_t held;    /* kind that is held for a fault; -1: none */
    int32_t trusted; /* 1: other motors are compared with it */
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

/* Input of the filters for one sample; the samples of a tick are in order of time. */
struct filter_sample {
    double _Complex u; /* voltage, mean over the sample's interval, V */
    double _Complex i; /* current at the end of the interval, A */
    double nis;        /* normalised innovation squared; NaN: the filter skipped the sample */
    int64_t steps;     /* sub-steps in the interval, 1 or more */
    int64_t gap;       /* sub-steps missing before the interval */
    int64_t drive;     /* index of its drive */
    int64_t next; /* index of its drive's next sample in the tick; -1: none. Set by filter_run */
};

/* Limits of the speed for acquisition, rad/s electrical; constant. */
struct acquisition_limits {
    double w_on;  /* a drive becomes ready from this speed upwards */
    double w_off; /* stays so down to this; above 7 rad/s, as of R_s 20 % off at rated current */
};

/* Flux chords of one drive; `acquisition_restart` sets it to no sample seen. */
struct acquisition {
    double _Complex i_last;     /* current at the last sample, A */
    double _Complex i_start;    /* current where the open chord starts, A */
    double _Complex flux;       /* volt-seconds less the resistive drop over the open chord, Wb */
    double _Complex chord;      /* the last complete chord c_(k-1), Wb */
    double _Complex S1;         /* mean of c_k conj(c_(k-1)), Wb^2 */
    double _Complex S2;         /* mean of S1, Wb^2 */
    double _Complex turned_sum; /* rotated sum of chords, Wb */
    double S0;                  /* mean of |c|^2, Wb^2 */
    double span;                /* duration of a chord, s */
    double w;                   /* speed at the end of the last paired chord, rad/s electrical */
    double theta;               /* electrical angle at that time, rad */
    double age;                 /* time since that time, s */
    double spread;              /* circular standard deviation of the turn of a chord, rad */
    double w_max;               /* largest |w| that the length of the chords allows, rad/s */
    double psi; /* flux by length and turn, Wb, with the effect of R_s errors; NaN: no pair yet */
    int64_t steps;        /* sub-steps of the open chord; -1: it has no start */
    int64_t paired_steps; /* sub-steps of the last chord; 0: the next cannot form a pair with it */
    int64_t stride;       /* least sub-steps of the open chord */
    int64_t pairs;        /* number of pairs since the start */
    int64_t good;         /* number of consecutive plausible pairs */
    uint8_t ready;        /* 1: w and theta are valid */
};

/* Speed and angle of a filter compared with those of the flux chords. */
enum consistency {
    CONSISTENCY_UNKNOWN = 0,
    CONSISTENT = 1,
    INCONSISTENT = 2,
};

/* Integrals of a current z over the angle of the rotor. */
struct revolution_sums {
    double _Complex z;  /* of z, A rad */
    double _Complex z2; /* of z^2, A^2 rad */
    double abs2;        /* of |z|^2, A^2 rad */
};

/* Errors of the current sensors of one drive; all 0: nothing learnt. */
struct current_calibration {
    double _Complex offset;         /* offset learnt from `turns` revolutions, A */
    double _Complex image;          /* image from gain mismatch, learnt from the same */
    double _Complex offset_applied; /* offset that is subtracted now, A */
    double _Complex image_applied;  /* image that is compensated now */
    double _Complex line;           /* mean of z^2 / |z|^2, in which small currents count less */
    struct revolution_sums sum_uniform; /* over the current revolution */
    struct revolution_sums sum_ramp;    /* the same, with a weight that rises from 0 to 1 */
    struct revolution_sums ramp_before; /* `sum_ramp` of the revolution before */
    double turned;                      /* angle of the current revolution so far, rad */
    double mean_square;                 /* mean square over the revolution before, A^2; 0: none */
    double seen;                        /* mean weight of the samples in `line`, 0 to 1 */
    double step_s;                      /* time between the last two samples, s */
    int64_t turns;                      /* number of revolutions learnt from, at most 16 */
    uint8_t single_axis;                /* 1: the current oscillates on one line (open phase) */
};

/* The filter of one drive. */
struct filter {
    double x[5];     /* i_alpha, i_beta (A), w_e (rad/s), theta_e (rad), T_L (Nm) */
    double P[5][5];  /* covariance of x */
    double nis;      /* normalised innovation squared, smoothed */
    double r_scale;  /* factor on R, learnt from the innovations */
    double v_q_bias; /* error of the predicted q-axis voltage, V: R_s or psi_f off the data sheet */
    int64_t steps;   /* sub-steps since the start; -1: it has just become not finite */
    int64_t first_sample; /* index of its first sample in the tick; -1: none. Set by filter_run */
    uint8_t active;       /* 1: there is a filter */
    uint8_t is_finite; /* 0: in this tick a state would have become not finite, or a variance < 0 */
};

/* Process and measurement noise of the filter of one drive; constant. */
struct filter_noise {
    double Q[5];  /* variance added to x per sub-step */
    double R[2];  /* variance of the currents, A^2; `r_scale` multiplies it */
    double coast; /* variance of the currents in and after a gap, A^2 */
};

/* Settings of all filters; constant. */
struct filter_settings {
    double dt;    /* sub-step, s */
    double kappa; /* scaling of the UKF, above -5; 5 + kappa = 3 matches a Gaussian's kurtosis */
    uint8_t unscented; /* 1: UKF, 0: EKF */
};

/* The train, as all its rotors and commands together show it (gateway/core/train.c). Speeds are
 * rotor speeds, rad/s; loads and torques are per unit of rated torque; NaN: not known. */

/* One rotor: its ratings and its state. */
struct rotor {
    double rated_nm;      /* rated torque, Nm */
    double inertia_kg_m2; /* moment of inertia of the rotor, kg m2 */
    double speed;       /* along the train, over `diameter`; negative: the rotor turns backwards */
    double load;        /* load in this tick, in the direction in which the rotor turns */
    double slow_speed;  /* smoothed speed, from which the acceleration is found */
    double quick_speed; /* the same, less smoothed */
    double acceleration_torque; /* torque that accelerates the rotor with its train */
    double brake_torque; /* additional such torque if friction brakes slow the train; else 0 */
    double braked_creep; /* creep that it has gained if the braking credited to it was a loss */
    double diameter;     /* learnt ratio of its speed to the others' by the wheel's diameter */
    double learnt_s;     /* time for which `diameter` has been learnt, s */
    double creep;        /* speed over that of the others, minus 1 */
    double slip;        /* `speed` over `train_speed` minus 1, negated in braking; NaN: not known */
    double train_speed; /* in the first rotor of a motor only: bound of the train's speed */
    double train_limit; /* the same bound, moving faster than the speed of any train */
    double unseen_s;    /* in the first only: time without any tracked rotor, s */
    double unsure_s;    /* in the first only: time without any rotor known to adhere, s (creep.c) */
    double sure_speed;  /* in the first only: `train_speed` when that time began; 0: not known */
    double sliding_s;   /* time for which it has been far beyond `train_limit`, s */
    double ahead_s;     /* time for which it has carried load with a negative `slip`, s */
    double followed_s;  /* time for which the filter has tracked, s */
    double alone_s;     /* time for which all other rotors have been away, s */
    double near_s;      /* time for which its creep has been within the limit for adhering, s */
    double slides_s;    /* time for which it has been apart and carried more than the others, s */
    double uncommanded_s;        /* time for which its load has exceeded its command, s */
    double odd_s;                /* time for which its command has been odd, s */
    int64_t unreliable_until_ns; /* until then its currents are no evidence of a loss; or NO_TIME */
    int32_t motor;               /* index of the first rotor with the same ratings; constant */
    int32_t next_alike;          /* index of the next rotor with the same ratings; 0: none */
    int8_t way;        /* sign of its speed when it last adhered; 0: not known (creep.c) */
    int8_t forward;    /* sign of its speed when it last turned; 0: it has not turned yet */
    uint8_t far;       /* 1: too far from the others, while its diameter is not known */
    uint8_t apart;     /* 1: too far from the others when their distance was last known */
    uint8_t away;      /* 1: its own torque made it run away from the others; not back yet */
    uint8_t sliding;   /* 1: so far from the train's speed that it is lost, whatever it carries */
    uint8_t uncertain; /* 1: it may be running away, or something else may brake it */
    uint8_t odd;       /* 1: its command has been odd for too long */
    uint8_t above;     /* 1: its load is no measure for others: it slides, or exceeds its command */
};

/* Results of the preceding stations for one drive in this tick. */
struct rotor_inputs {
    double measured_rad_s;      /* speed by `Motion`, rad/s; NaN: there is no fresh one */
    double speed_rad_s;         /* estimated speed, rad/s */
    double load_nm;             /* estimated load, Nm */
    double command_nm;          /* torque command, Nm */
    double previous_command_nm; /* torque command before that, Nm */
    uint8_t health;             /* enum filter_health; overwritten if the drive is not judged */
    uint8_t health_reason;      /* enum reason; written if the drive is not judged */
    uint8_t adhesion;           /* enum flag_state: adhesion flag of the last tick */
    uint8_t operating;          /* 1: the drive is in operation */
    uint8_t command_valid;      /* 1: the command is known; cleared if it cannot be right */
    uint8_t may_be_off;         /* 1: it may have stopped; its next `Status` will say */
    uint8_t not_judged;         /* output, 1: the estimate of the drive is not used */
    uint8_t withdrawn;          /* output, 1: it is off and rolls along: its flag is withdrawn */
};

/* One temperature sensor; the first three are constants. Stamps: INT64_MIN before the first. */
struct temperature_sensor {
    double limit_k;         /* K, a larger change that lasts is an offset */
    int64_t stuck_after_ns; /* ns, a value that is held for longer means a stuck sensor */
    uint8_t configured;     /* 1: the drive has this sensor */
    uint8_t seen;           /* 1: there was a valid value */
    uint8_t saturated;      /* 1: it has warmed up to the signal's maximum and may stay there */
    uint8_t moved;          /* 1: it has shown two different values */
    uint8_t impossible;     /* 1: colder than any motor, or at the maximum from the start */
    uint8_t near;           /* 1: it has been near the other motors' sensors since it started */
    int32_t step_count;     /* number of consecutive readings beyond the limit */
    int64_t raw;            /* last valid value, tenths of a degree; -1: none */
    int64_t changed_ns;     /* stamp since which `raw` has not changed */
    int64_t valid_ns;       /* stamp of the last valid value */
    double value_c;         /* degC, last valid value */
    double level_c;         /* degC, smoothed value, without offset */
    double slope_k;         /* K per reading, smoothed */
    double step_k;          /* K, largest sudden change among the readings of `step_count` */
    double bias_k;          /* K, offset of the sensor; 0: none */
    int64_t valid_at;       /* number of the drive's reading, from 1, with its last valid value */
    int64_t step_index;     /* number of the reading that gave it its offset */
};

/* Temperature sensors of one drive. */
struct temperature_drive {
    int64_t period_ns;                                /* cycle time of the readings; constant */
    int64_t received_ns;                              /* stamp of the last reading */
    int64_t first_ns;                                 /* stamp of the first reading */
    int64_t readings;                                 /* number of readings */
    struct temperature_sensor sensor[THERMAL_POINTS]; /* sensors by point, without ambient */
};

/* ---- received messages (gateway/core/receive.c, pairing.c, supervision.c); times in ns, -1: none */

#define MAX_USED_COLUMNS 33 /* most signals of one message that the gateway uses */
#define PAIR_COUNTERS    16 /* values of the counter that pairs currents with voltages */
#define STANDARD_IDS     2048
#define HEARTBEAT_NODES  128
#define HEARTBEAT_GAPS   5 /* the heartbeat period is the median of this many gaps */
#define TIMEOUT_PERIODS  3 /* consumer time-out, in heartbeat periods */

/* Content of a message; the first three kinds become samples. */
enum channel_kind {
    KIND_CURRENTS = 0,
    KIND_VOLTAGES = 1,
    KIND_BLOCK = 2, /* eight samples of both */
    KIND_MOTION = 3,
    KIND_TEMPERATURES = 4,
    KIND_STATUS = 5,
};

/* Owner of an identifier that belongs to no channel. */
enum id_owner {
    ID_UNKNOWN = -1,
    ID_OWN = -2,        /* the gateway's own */
    ID_SUPERVISED = -3, /* heartbeat or emergency of a drive's node */
};

/* Each received frame is counted in one of these; RX_LOST counts frames that were not received. */
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

/* Signs of a second sender of one message (gateway/core/sequence.c). */
struct sequence_guard {
    double shortest_step_ns;   /* constant: a counter step in less time is a sign */
    int64_t counter_ns;        /* stamp of the frame that the next counter is compared with */
    int64_t error_ns;          /* stamp of the last sign */
    int64_t rejected_until_ns; /* frames are rejected until then, after enough signs */
    int32_t errors;            /* number of signs */
    int32_t repeats;           /* see MAX_REPEATS in sequence.c */
};

/* One received message of one drive. */
struct channel {
    /* constants */
    int64_t period_ns;    /* cycle time */
    int64_t limit_ns;     /* age limit: three periods and a tick */
    int32_t message;      /* its number in the codec */
    int32_t drive;        /* position in the configuration */
    int32_t signal_count; /* columns of a decoded row */
    int32_t quality;      /* column of the signal `Quality`; -1: it has none */
    int32_t steps;        /* sub-steps of 125 us between two samples */
    int32_t column_count; /* number of used columns */
    int32_t columns
        [MAX_USED_COLUMNS]; /* signals that the gateway uses, in gateway/core/channel.py's order */
    uint8_t kind;           /* enum channel_kind */
    struct e2e_config e2e_config; /* protection of its frames */
    /* state */
    struct e2e_state e2e_state;        /* state of the receiver of that protection */
    int64_t received_ns;               /* stamp of the last frame, good or bad */
    int64_t accepted_ns;               /* stamp of the last frame with good protection */
    int64_t good_ns;                   /* stamp of the last frame whose values could be used */
    struct sequence_guard guard;       /* signs of a second sender of this message */
    uint8_t last_frame[PAYLOAD_BYTES]; /* bytes of the last frame with a good checksum */
    uint8_t reject_reason;             /* enum reason why the last values could not be used */
    uint8_t protection_reason;         /* enum reason of the last error of the protection */
    uint8_t reason;    /* enum reason why the channel is unknown now; REASON_NONE: it is known */
    uint8_t was_valid; /* 1: its receiver has been in E2E_SM_VALID */
};

/* Currents or voltages that wait for the other half of a sample. */
struct half_sample {
    double value[2]; /* alpha, beta; A or V */
    int64_t t_ns;    /* stamp; -1: none waits */
};

/* Delays of one drive's samples (gateway/core/sample_clock.c). */
struct sample_clock {
    int64_t late_ns;  /* delay of the last sample */
    int64_t mean_ns;  /* mean period of the samples */
    int64_t usual_ns; /* usual delay of the samples */
    int64_t samples;  /* number of samples since the start; it stops at the number needed */
    double u[2];      /* voltage of the last sample, V, alpha and beta */
    double turn[2];   /* mean product of a voltage and the conjugate of the one before, V^2 */
};

/* Last inputs of one drive; NaN: nothing received yet. */
struct drive_input {
    struct half_sample pending[2][PAIR_COUNTERS]; /* by enum channel_kind, by counter */
    int64_t sample_ns;                            /* stamp of the last sample */
    int64_t sample_counter;                       /* counter of the last sample */
    struct sample_clock clock;                    /* delays of its samples */
    int64_t newest_sample;   /* row of its newest sample in this tick; -1: none */
    double current_sum;      /* smoothed |Ia + Ib + Ic|, A */
    double speed;            /* rotor speed, rad/s */
    double command;          /* torque command, Nm */
    double previous_command; /* torque command before that, Nm */
    double irms;             /* rms current, A, sent with the command */
    int64_t command_ns;      /* stamp of the command */
    int64_t emergency_ns;    /* stamp of the last emergency that counts (receive.c); -1: none */
    uint8_t command_steady;  /* 1: the command hardly differs from the one before */
    uint8_t operating;       /* 1: `State` is Operation, or the drive sends none */
    uint8_t restart;         /* 1: its filter starts anew in this tick */
};

/* Heartbeat of one node (CiA 301); INT64_MIN is no stamp here. */
struct heartbeat {
    int64_t last_ns;                /* stamp of the newest frame; INT64_MIN: none */
    int64_t since_ns;               /* stamp that the next gap is measured from; INT64_MIN: none */
    int64_t gap_ns[HEARTBEAT_GAPS]; /* last gaps between two heartbeats, a ring */
    int64_t gaps;     /* number of gaps so far; -1: after an answer to node guarding */
    int64_t limit_ns; /* consumer time-out; 0: not supervised */
    int64_t boots;    /* number of boot-up messages */
    int64_t state;    /* NMT state; -1: none yet */
    int64_t asked;    /* 1: a node-guard request since the last frame */
};

/* Heartbeats of all nodes. */
struct supervision {
    struct heartbeat *nodes;      /* (drives) heartbeats of the drives' nodes */
    int64_t malformed;            /* number of heartbeat frames of a wrong format */
    int64_t timeout_ns;           /* shortest consumer time-out */
    int64_t period_ns;            /* configured heartbeat period; 0: the received one */
    int32_t row[HEARTBEAT_NODES]; /* index in `nodes` by node number; -1: not a drive's node */
};

/* Owner of one identifier; 29-bit and 11-bit identifiers are in ascending order of `key`. */
struct id_entry {
    int64_t key;     /* identifier; bit 31 set for a 29-bit one */
    int64_t channel; /* index of its channel, or enum id_owner */
};

/* Counts of the contents of one tick's frames. */
struct received {
    int64_t accepted;     /* accepted frames */
    int64_t samples;      /* rows of samples */
    int64_t motions;      /* readings of Motion */
    int64_t temperatures; /* rows of temperatures */
    int64_t emergencies;  /* emergencies of the drives' nodes */
    int64_t restarts;     /* drives whose filter starts anew */
    int64_t own;          /* frames with the gateway's own identifiers */
};

/* State of the receiving stations. All arrays have room for as many frames as a tick may have. */
struct receiver {
    const struct codec *codec;       /* codec of the received messages */
    struct channel *channels;        /* (channel_count) received messages of all drives */
    struct drive_input *drives;      /* (drive_count) last inputs */
    struct supervision *supervision; /* heartbeats of the drives' nodes */
    const struct id_entry *ids; /* (id_count) owners of all known identifiers, ascending by `key` */
    int64_t channel_count;      /* number of `channels` */
    int64_t drive_count;        /* number of drives */
    int64_t id_count;           /* number of `ids` */
    int64_t max_gap_ns;         /* after longer without a sample, a drive's filter starts anew */
    int64_t standard_ids[STANDARD_IDS]; /* owner of each 11-bit identifier, as `id_entry.channel` */
    /* accepted frames of the tick, decoded */
    int64_t *channel;  /* index of the frame's channel */
    int32_t *message;  /* number of its message in the codec */
    int64_t *t_ns;     /* stamp */
    uint8_t *payload;  /* PAYLOAD_BYTES per row */
    double *value;     /* (rows, codec->width) physical values */
    uint8_t *validity; /* (rows, codec->width) enum signal_validity */
    /* samples of the tick, in the order of the filters' rows (gateway/core/pairing.py) */
    int32_t *sample_drive;  /* index of the drive */
    double *sample_u;       /* V, alpha and beta */
    double *sample_y;       /* A, alpha and beta */
    int64_t *sample_steps;  /* sub-steps in the sample's interval */
    int64_t *sample_gap;    /* sub-steps missing before it */
    int64_t *sample_before; /* row of the same drive's previous sample in this tick; -1: none */
    /* readings of Motion in the tick (gateway/core/pairing.py) */
    int64_t *motion_drive; /* index of the drive */
    int64_t *motion_t_ns;  /* stamp */
    double *motion_speed;  /* rad/s */
    double *motion_torque; /* Nm */
    double *motion_angle;  /* rad */
    /* rows of the tick for the temperature station and for Python */
    int64_t *temperature_rows;     /* accepted frames with temperatures */
    int64_t *emergency_rows;       /* received frames that are emergencies */
    int64_t received;              /* frames received since the start */
    int64_t counters[RX_COUNTERS]; /* frames by enum rx_counter, since the start */
    int64_t unpaired;              /* halves of samples without a counterpart, since the start */
    int64_t late;         /* samples rejected because they came too late, since the start */
    int64_t left_out;     /* samples that senders left out without counting them, since the start */
    struct received tick; /* counts of the current tick */
};

/* ---- sent messages, and the load of the bus (gateway/core/transmit.c, busload.c) */

#define DATA_LENGTHS 256 /* values that the 8-bit length of a frame can have */

/* Source of the value of a sent signal. */
enum tx_source {
    TX_START_VALUE = 0, /* none: the signal keeps its start value */
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

/* Quality of the values of a message, as its sender rates it; the numbers are those of the DBC. */
enum quality {
    QUALITY_INITIALISING = 0,
    QUALITY_VALID = 1,
    QUALITY_DEGRADED = 2,
};

/* One signal of a sent message; constant. */
struct tx_signal {
    uint8_t source; /* enum tx_source */
    uint16_t drive; /* index of the drive whose value it carries */
};

/* One message that the gateway sends. */
struct tx_message {
    /* constants */
    int64_t cycle_ns;                /* cycle time, at least 1 */
    struct e2e_config e2e_config;    /* protection of its frames */
    int32_t signal_count;            /* number of `signals` */
    uint8_t on_change;               /* 1: also sent when a flag that reports faults changes */
    const struct tx_signal *signals; /* (signal_count) sources of values, in the codec's order */
    /* state */
    int64_t next_ns; /* stamp when it is due */
    uint8_t counter; /* number of frames sent, modulo 256 */
};

/* One frame that is sent. */
struct tx_frame {
    int64_t t_ns;                /* stamp */
    int32_t message;             /* index of its `struct tx_message` */
    uint8_t data[PAYLOAD_BYTES]; /* data bytes; zeros after the message's length */
};

/* Counts and measurements, as they are sent. NaN: not known. */
struct gateway_counts {
    double deadline_misses;  /* number of skipped ticks */
    double rejected;         /* rejected frames with a known identifier */
    double lost;             /* lost frames */
    double bus_load_percent; /* see busload.c */
    double latency_p99_us;   /* 99th percentile of the latency, measured by the driver */
    double lateness_p99_us;  /* 99th percentile of the lateness, measured by the driver */
    double config_hash;      /* hash of the configuration; constant */
    int64_t rejected_before; /* part of `rejected` that a translator rejected before reception */
};

/* State of the transmitting station; messages are in the order of their identifiers. */
struct transmitter {
    /* constants */
    const struct codec *codec;   /* codec of these messages */
    struct tx_message *messages; /* (message_count) messages in the order of their identifiers */
    int32_t message_count;       /* number of `messages`, and most frames of one tick */
    int32_t drive_count;         /* number of drives */
    int64_t tick_ns;             /* period of the loop */
    int64_t slack_ns;            /* what is due within this time is due now */
    /* state */
    struct gateway_counts counts; /* counts and measurements to be sent */
    uint8_t *thermal_sent;        /* (drives) thermal flags of the last tick (enum flag_state) */
    uint8_t summary_sent[4];      /* sensor, comm, estimator and overrun of the last tick */
    /* workspace for one frame: (width of the codec) */
    double *value;  /* value of each signal; NaN: sent as not available */
    uint8_t *given; /* 1: the signal has a value; 0: it keeps its start value */
};

/* Share of the bus in use over the last full second, with worst-case bit stuffing. */
struct bus_load {
    double classic_s[DATA_LENGTHS]; /* s, duration of a classic frame by its number of data bytes */
    double fd_s[DATA_LENGTHS];      /* s, duration of a CAN FD frame by its number of data bytes */
    int64_t since_ns;               /* stamp of the start of the window */
    double busy_s;                  /* s, duration of all frames in the window */
    double percent;                 /* %, of the last complete window; NaN: none yet */
};

/* ---- degradation, and a train's thermal monitor (estimators/thermal/trend.c, monitor.c) */

/* Degradation of one motor relative to the others: a local linear trend. */
struct trend {
    double level_k;    /* K above the others; NaN: no reading yet */
    double rate_k_h;   /* K/h, rate of degradation */
    double cov[2][2];  /* covariance of level and rate */
    double observed_h; /* h, duration of the readings so far */
};

/* Monitor of all motors; `struct thermal_motor` holds the state of each. */
struct thermal_monitor {
    const struct thermal_config *config;      /* settings, the same for all motors */
    const struct thermal_motor_config *known; /* (motor_count) constants of the motors */
    struct thermal_motor *motors;             /* (motor_count) states of the motors */
    struct motor_current *currents;           /* (motor_count) which of them are driven */
    double *workspace;                        /* 11 numbers per motor */
    int32_t motor_count;                      /* number of motors */
    int32_t position;                         /* number of samples in the current block */
    int32_t waiting; /* motors, the last ones, whose last block is not judged yet */
};

/* ---- temperatures in the gateway (gateway/core/thermal.c, thermal_evidence.c) */

/* Quantities averaged over a second: temperatures of the sensors, degC, then these. */
enum thermal_quantity {
    THERMAL_CURRENT_SQUARE = 3, /* A^2, of the current's amplitude */
    THERMAL_SPEED = 4,          /* rad/s, without sign */
    THERMAL_AMBIENT = 5,        /* degC */
    THERMAL_QUANTITIES = 6,
};

/* Method by which thermal faults of motors are found. */
enum thermal_method {
    THERMAL_UNCALIBRATED = 0, /* none: thermal flags are unknown */
    THERMAL_MAISD = 1,        /* comparison of the motors (estimators/maisd.c) */
    THERMAL_MODEL = 2,        /* thermal models (estimators/thermal/monitor.c) */
};

/* Evidence from one motor's temperatures. NaN: not known. */
struct thermal_evidence {
    double mixed_c;       /* degC, mean of the motor's valid sensors */
    double maisd_k;       /* K, largest MAISD of all points */
    double rate_k_h;      /* K/h, rate of degradation */
    int64_t jumps;        /* number of temperature steps of its sensors so far */
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
    double ambient_c;                  /* degC, last received ambient temperature; NaN: not valid */
    double total[THERMAL_QUANTITIES];  /* sums over the current second */
    double number[THERMAL_QUANTITIES]; /* number of values in each sum */
    double mean[THERMAL_QUANTITIES];   /* means over the last complete second; NaN: no value */
    struct trend trend;                /* degradation relative to the other motors */
    double step_k[THERMAL_POINTS];     /* K, last known offset by steps of each sensor */
    int64_t jumps;                     /* how often `step_k` has changed */
    struct thermal_evidence evidence;  /* evidence of the last judgement */
    int64_t valid_until_ns; /* `evidence` stands until then; NO_TIME: to be judged anew */
    uint8_t fresh;          /* 1: its readings are within their age limit */
    uint8_t left_out; /* 1: it was cut out, and is colder than the driven ones: not compared */
};

/* Temperatures averaged over a window, (drives, THERMAL_POINTS), and their MAISD. */
struct temperature_window {
    /* constants */
    double *gain;                   /* gain of each sensor relative to the fleet */
    double *offset_k;               /* K, offset of each sensor relative to the fleet */
    double limit_k[THERMAL_POINTS]; /* K, limit of `spread` */
    double apart_k[THERMAL_POINTS]; /* K, limit of `deviation` */
    int32_t samples;                /* number of samples in the window */
    /* state */
    double *ring;      /* (samples, drives, THERMAL_POINTS) degC, NaN: not valid */
    double *value;     /* last valid values, degC */
    uint8_t *valid;    /* 1: `value` is valid now */
    double *mean;      /* over the window, degC */
    uint8_t *known;    /* 1: `mean` is known, and the sensor is valid now */
    uint8_t *compared; /* 1: it is, and the motor is compared with the others */
    double *centred;   /* K, (`mean` - `offset_k`) / `gain` */
    double *deviation; /* K above the others' median, the smaller of two centrings; NaN: none */
    double spread[THERMAL_POINTS]; /* K, MAISD; NaN: fewer than two motors */
    /* workspace */
    int64_t *number; /* number of values in each mean */
    double *ranked;  /* (drives) */
    double *uniform; /* (drives, THERMAL_POINTS) K, `deviation` of `mean` without centring */
};

/* Temperature monitor of all motors. */
struct temperature_monitor {
    /* constants */
    int64_t period_ns;         /* cycle time of the readings */
    int32_t drive_count;       /* number of drives, each with one motor */
    int32_t cycles_per_second; /* number of readings in one sample of the model */
    double named;   /* share of a fault's probability from which heat, or a sensor, is named */
    uint8_t method; /* enum thermal_method */
    struct temperature_drive *sensors; /* (drive_count) */
    struct motor_temperatures *motors; /* (drive_count) */
    struct thermal_monitor *model;     /* NULL: no model */
    struct motor_current *currents;    /* (drive_count), those of the model if there is one */
    struct cut_out_config cut_out;     /* without a model */
    struct temperature_window window;  /* averages over the window, and their comparison */
    /* state */
    int64_t next_ns; /* stamp when the next temperature cycle is due; NO_TIME: no reading yet */
    int64_t cycles;  /* number of temperature cycles so far */
    int64_t next_report_ns;  /* stamp when evidence changes even if nothing is received */
    int32_t cycle;           /* number of temperature cycles in the current second */
    uint8_t second_complete; /* 1: the last cycle completed a second */
    uint8_t dirty;           /* 1: evidence may have changed since it was last reported */
    /* workspace for one sample of the model: (drives, THERMAL_POINTS) and (drives) */
    double *reading; /* (drives, THERMAL_POINTS) degC, means of a second; NaN: no value */
    struct thermal_input *input; /* (drives) inputs of the model, means of the same second */
};

/* Temperature cycles of all motors, from which a calibration is learnt (thermal_log.c). */
struct temperature_log {
    int64_t capacity; /* most cycles that fit */
    int64_t count;    /* number of logged cycles */
    int64_t cycles;   /* `cycles` of the monitor when the last cycle was logged */
    /* (capacity) */
    uint8_t *second_complete; /* 1: the cycle completed a second */
    /* (capacity, drives, THERMAL_POINTS) */
    double *value_c;  /* last values, degC */
    double *mean_c;   /* over the window, degC */
    uint8_t *known;   /* 1: the mean is known, and the sensor is valid */
    int64_t *held_ns; /* time since the sensor's value changed */
    /* (capacity, drives, THERMAL_QUANTITIES) */
    double *second; /* means of the last complete second; NaN: no value */
};

/* ---- candump text (dbc/candump_read.c, dbc/candump_write.c) ---- */

#define CANDUMP_MAX_NAME 21  /* most bytes of an interface name in a line */
#define CANDUMP_NAMES    64  /* most interface names of a log that are read without Python */
#define CANDUMP_MAX_TEXT 192 /* most bytes of a written line, line end included */

/* Kind of a line. Only the first two kinds have a frame. */
enum candump_line {
    LINE_CLASSIC = 0,
    LINE_FD = 1,
    LINE_OTHER = 2, /* dbc/candump/grammar.py decides */
    LINE_BLANK = 3,
    LINE_COMMENT = 4,
    LINE_MALFORMED = 5,
};

/* Name of a CAN interface, as in a line. */
struct interface_name {
    uint8_t text[CANDUMP_MAX_NAME]; /* bytes of the name; the first `length` count */
    uint8_t length;                 /* number of bytes; 0: no name, or one that no line can have */
};

/* Frames as columns (dbc/frames.py), one row per frame. */
struct frame_columns {
    int64_t *t_ns;     /* stamp of reception */
    uint32_t *can_id;  /* identifier, without flags */
    uint8_t *flags;    /* enum frame_flag */
    uint8_t *length;   /* number of data bytes; 255: more than a row has room for */
    uint8_t *data;     /* PAYLOAD_BYTES per row, zeros after the length */
    int8_t *dlc;       /* -1: same as the length; else the raw DLC, or that of a remote frame */
    uint16_t *channel; /* index of its interface name */
};

/* One frame: a row of `struct frame_columns`. */
struct frame {
    int64_t row;     /* index of the row in the block */
    int64_t t_ns;    /* stamp of reception */
    uint32_t can_id; /* identifier, without flags */
    uint8_t flags;   /* enum frame_flag */
    uint8_t length;  /* number of data bytes */
    uint8_t *data;   /* PAYLOAD_BYTES */
};

/* ---- text logs of others (dbc/text_read.c) ---- */

#define TEXT_HEADS    4096 /* most different heads of a log that are read without Python */
#define TEXT_MAX_HEAD 63   /* most bytes of a head */

/* Layout of the plain lines of a format: words, a time, the words of the head, data. */
struct text_shape {
    int64_t unit_ns;      /* of the time, ns */
    int32_t words_before; /* number of words before the time */
    int32_t head_words;   /* number of words between the time and the data */
    int32_t marker_word;  /* index of the head word that has to be `marker`; -1: none */
    uint8_t marker;       /* a character */
};

/* Head of a line: the text between its time and its data. */
struct text_head {
    uint8_t text[TEXT_MAX_HEAD]; /* bytes of the head; the first `length` count */
    uint8_t length;              /* number of bytes; 0: no head */
};

/* ---- which inputs are valid (gateway/core/inputs.c) ---- */

/* Channels of one drive, and limits of its inputs; constant. */
struct drive_channels {
    double max_current_sum_a; /* A, the phase currents of a motor have no larger sum */
    int64_t max_age_ns;       /* age limit of a sample of current */
    int32_t first;            /* index of its first channel; the others follow */
    int32_t end;              /* index after its last channel */
    int32_t electrical[2];    /* channels of currents and voltages; -1: none */
    int32_t motion;           /* channel of Motion; -1: none */
    int32_t status;           /* channel of Status; -1: none */
};

/* Validity of the inputs of one drive in this tick. */
struct input_status {
    double speed_rad_s;        /* speed of the rotor, rad/s, by a fresh Motion; NaN: not known */
    uint8_t heartbeat_lost;    /* 1: its heartbeat was received and has stopped; set by tick.c */
    uint8_t reason;            /* enum reason why currents and voltages are not valid */
    uint8_t sample_fresh;      /* 1: the newest sample is within its age limit */
    uint8_t command_valid;     /* 1: the torque command is known */
    uint8_t current_sum_fault; /* 1: the phase currents do not sum to zero */
    uint8_t comm;              /* enum flag_state: evidence of the drive's communication */
};

/* ---- estimates, and what the drives measure themselves (gateway/core/motion.c, plausibility.c).
 * Speeds are those of rotors unless they are called electrical. ---- */

#define CURRENT_HISTORY 8 /* number of samples of current that are kept: those of a CAN FD frame */

/* Estimates of one drive in this tick; NaN: not known. */
struct drive_estimate {
    double speed_rad_s;    /* speed of the rotor, rad/s */
    double load_nm;        /* load, Nm */
    double load_sigma_nm;  /* standard deviation of the load, Nm */
    double nis;            /* normalised innovation squared, smoothed */
    double flux_ratio;     /* flux of the magnets over that of the data sheet */
    uint8_t health;        /* enum filter_health */
    uint8_t health_reason; /* enum reason why it is not tracked */
    uint8_t by_observer; /* 1: from speed and torque (motion.c); 0: by the filter, from currents */
    uint8_t crawls;      /* 1: so, because the rotor is too slow for the filter */
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
    double P_ww;   /* variance of w, (rad/s)^2 */
    double P_wL;   /* covariance of w and T_L, rad/s Nm */
    double P_LL;   /* variance of T_L, Nm^2 */
    double torque; /* torque of the last reading, Nm */
    double nis;    /* normalised innovation squared of the last reading */
    double spread; /* slow mean of `nis`: variance of the errors over that by P */
};

/* Comparison of one drive's measured speed and torque with its estimate. */
struct motion {
    struct mechanics mechanics;    /* constant */
    double pole_pairs;             /* constant, above 0 */
    struct load_observer observer; /* state after the last reading */
    double smooth_speed;           /* speed of the filter without its noise, rad/s; NaN: none */
    int64_t reading_ns;            /* stamp of the last reading */
    int64_t readings;              /* number of readings since the observer started */
    int64_t unlocked_ns;           /* time for which the filter has not found a rotor that turns */
    int64_t disagree_ticks; /* consecutive ticks in which measured and estimated speed disagree */
    uint8_t started;        /* 1: there was a reading */
    uint8_t aliasing;       /* 1: too few samples of current per revolution for the filter */
    uint8_t crawls;         /* 1: too slow for the filter to be sure of finding the rotor */
    uint8_t implausible;    /* 1: the input of the drive is implausible */
};

/* Plausibility of one drive's currents and of its Motion. */
struct plausibility {
    /* constants */
    double torque_per_a;   /* Nm per A along q, at the flux of the data sheet */
    double rated_a;        /* rated current, A */
    double rated_nm;       /* rated torque, Nm */
    double least_change_a; /* A, a constant current that should change by more is a repeat */
    double current_var;    /* variance of a current as configured, A^2; `r_scale` multiplies it */
    /* repeated currents */
    double current[CURRENT_HISTORY][2]; /* alpha, beta of the last samples, A, a ring */
    uint64_t samples;                   /* number of samples so far */
    int64_t repeats;                    /* consecutive samples equal to the one before */
    int64_t block_repeats; /* consecutive samples equal to the one CURRENT_HISTORY before */
    double repeated_s;     /* duration of `repeats`, s */
    /* angle of the current against the measured one */
    double _Complex base;    /* mean unit vector of the current in the frame of the rotor */
    double deviation;        /* recent deviation from `base`, rad */
    int64_t learnt;          /* number of readings in `base`, up to LEARN */
    int64_t angle_ns;        /* stamp of the last compared reading */
    int64_t angle_fitted_ns; /* stamp of the last reading that fitted */
    /* readings in a row that do not fit */
    int64_t angle_misfits;  /* the current's angle is too far from `base` */
    int64_t torque_misfits; /* the currents make another torque than the drive sends */
    int64_t excess_misfits; /* more torque than the currents can make */
    int64_t load_misfits;   /* the load of the filter differs from that of the observer */
    int64_t motion_misfits; /* Motion does not change */
    /* Motion as it last changed */
    double speed;       /* speed as sent, rad/s */
    double torque;      /* torque as sent, Nm */
    double command;     /* torque command at that time, Nm */
    int64_t changed_ns; /* stamp of that change */
    /* result */
    int64_t implausible_until_ns; /* the input is implausible until then */
    uint8_t restart;              /* 1: the filter has to start anew when that ends */
};

/* Records of n drives, and common constants, for motion.c and plausibility.c. */
struct motion_monitor {
    const struct receiver *receiver;     /* received frames and samples of this tick */
    struct input_status *inputs;         /* (n,) validity of the inputs */
    struct drive_estimate *estimates;    /* (n,) by the filters; motion.c may replace them */
    struct filter *filters;              /* (n,) filters of the estimator */
    const struct acquisition *chords;    /* (n,) flux chords of the estimator */
    struct current_calibration *sensors; /* (n,) errors of the current sensors */
    struct rotor *rotors; /* (n,) rotors of the train; here only `unreliable_until_ns` is written */
    struct motion *motions;      /* (n,) comparison of Motion with the estimates */
    struct plausibility *checks; /* (n,) plausibility of currents and Motion */
    double *others;          /* (n, n) measured speeds of all drives: a row for each tick in which
                                Motion of some drives changed last */
    int64_t *noted;          /* (n,) the row of every drive; below n */
    uint8_t *taken;          /* (n,) workspace */
    double max_w_e;          /* electrical speed beyond which samples are too few, rad/s */
    double turning_w_e;      /* electrical speed beyond which a filter finds its rotor, rad/s */
    double crawl_w_e;        /* electrical speed below which it may not, rad/s */
    double period_s;         /* time between two samples of current, s */
    double dt;               /* sub-step of samples, s */
    int64_t motion_cycle_ns; /* cycle time of Motion, at least 1 */
    int64_t tick_ns;         /* period of the loop */
    int64_t n;               /* number of drives */
};

/* ---- Adhesion (gateway/core/loads.c, adhesion.c). Loads and torques are per unit of rated torque;
 * NaN: not known. ---- */

/* Load of one drive: results of this tick, and state. */
struct drive_load {
    double load;          /* load in the direction of the train; 0: not known */
    double sigma;         /* standard deviation of `load`, as estimated; 0: not known */
    double command_ratio; /* torque command over the largest of all drives, if the drive obeys it */
    double asked_ratio;   /* the same, obeyed or not; at least RATIO_FLOOR */
    double most_asked;    /* the largest command of the last seconds, per unit */
    double p_response;    /* probability of a loss by the response to its own command */
    double last_speed;   /* speed in the tick before, rad/s; NaN unless the drive is judged alone */
    double last_spin_up; /* torque that accelerated the rotor in the tick before */
    double regripped_s;  /* s left in which its own slip control may hold it back; 0: none */
    int64_t flagged_ns;  /* stamp of the last tick with a bad adhesion flag; NO_TIME: none */
    double unknown_s;    /* s for which its load was not known, up to the tick before; 0: it was */
    int64_t known_since_ns;  /* stamp since which its load is known; NO_TIME: not known */
    uint8_t derating_active; /* 1: its flag is bad, or was just now: it reduces its torque */
    uint8_t response_valid;  /* 1: `p_response` is valid */
    uint8_t severe_loss;     /* 1: too much load is missing for noise */
    uint8_t by_observer;     /* 1: the load is that of the observer */
};

/* State of the adhesion station; `adhesion_reset` sets it to nothing remembered. */
struct adhesion {
    /* constants */
    const struct flag_rules *rules; /* times and thresholds of the adhesion flags */
    struct vb_priors priors;        /* prior of the detector `vb`; not used by others */
    double tick_s;                  /* period of the loop, s */
    int32_t iterations;             /* number of iterations of the detector `vb` */
    int32_t n;                      /* number of drives */
    /* of every drive, (n,) */
    struct rotor *rotors; /* ratings of the rotor, and its state relative to the train */
    struct rotor_inputs *rotor_inputs;  /* results of the preceding stations in this tick */
    struct command_response *responses; /* load and command in the direction of the motor */
    struct load_ratio *response_ratios; /* load over the drive's own command, as learnt */
    struct load_ratio *ratios;          /* load over that of the others, as learnt */
    struct load_observation *observed;  /* workspace */
    struct drive_load *loads;           /* load of the drive: results of this tick, and state */
    /* what the detector is given: loads as if the drives were equal and fully commanded */
    double *normalised; /* load over `command_ratio` and over the learnt ratio; valid if `known` */
    double *sigma;      /* standard deviation of a healthy drive's load around the common one */
    uint8_t *known;     /* 1: the load is known */
    uint8_t *compared;  /* 1: the load is known, and a measure for other drives */
    /* what it finds; fused with the responses in place */
    double *loss_probability; /* probability of lost adhesion, 0 to 1 */
    uint8_t *loss_known;      /* 1: `loss_probability` is valid */
    uint8_t *may_learn;       /* 1: the drive certainly adheres */
    double *workspace;        /* 5 n numbers */
    /* state */
    struct load_spread response_spread; /* of loads over commands */
    struct load_spread spread;          /* of loads over the common one */
    struct switching *switching;        /* NULL: another detector compares the drives */
    struct flag common_mode;            /* all drives have lost adhesion at once */
    int64_t learn_ns;                   /* stamp when ratios are learnt next; NO_TIME: at once */
    int64_t flagged_ns;      /* stamp of the last tick with any adhesion flag bad; NO_TIME: none */
    double common_missing_s; /* time for which all together have missed load, s (common_loss.c) */
    double common;           /* load that adhering drives share, by the detector */
    double common_smoothed;  /* the same, smoothed */
    uint8_t comparable;      /* 1: drives carry enough load to be compared */
};

/* ---- Estimates by the filters (gateway/core/estimate.c) ---- */

/* State of one drive beside its filter. */
struct filter_track {
    double best_sigma_nm;  /* smallest standard deviation of the load in recent ticks, Nm */
    double load_nm;        /* load after the last tick with samples, Nm, at the data sheet's flux */
    double load_change_nm; /* change of the load in that tick, Nm */
    double spread;         /* error of the load over its standard deviation by P, learnt */
    int64_t spread_ticks;  /* number of ticks that `spread` was learnt from */
    double flux_unsure;    /* relative flux deviation of the chords that R_s may explain */
    int64_t diverged_ns;   /* stamp of the divergence that is reported; -1: none */
    int64_t disagree_ticks; /* consecutive ticks in which the chords contradict the filter */
    uint8_t silent;         /* 1: no samples in this tick */
};

/* The filters of n drives; `estimator_reset` sets them to nothing known. */
struct estimator {
    /* constants, of every drive, (n,) */
    const struct pmsm *motors;        /* motor constants */
    const struct filter_noise *noise; /* noise of the filters */
    const double *rated_a;            /* rated current, A, above 0 */
    const double *rated_nm;           /* rated torque, Nm */
    /* constants of all */
    struct acquisition_limits limits; /* speeds at which a drive becomes ready, or no longer is */
    struct filter_settings settings;  /* sub-step, kind of filter, scaling of the UKF */
    double tick_s;                    /* period of the loop, s */
    int32_t n;                        /* number of drives */
    /* of every drive, (n,) */
    struct filter *filters;              /* filters of the rotors */
    struct acquisition *chords;          /* flux chords, from which filters start */
    struct current_calibration *sensors; /* errors of the current sensors, as learnt */
    struct filter_track *tracks;         /* state beside the filters */
    struct filter_sample *samples;       /* of the last tick; as many rows as the receiver has */
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

/* Layout of struct canfd_frame; a struct can_frame (linux/can.h) has only 8 bytes of data. */
struct socket_frame {
    uint32_t id;                 /* identifier, with three flags above it */
    uint8_t length;              /* number of data bytes; any number may come */
    uint8_t flags;               /* flags of CAN FD */
    uint8_t reserved;            /* not used */
    uint8_t raw_length;          /* of a classic frame of 8 bytes: its DLC, 9 to 15; else 0 */
    uint8_t data[PAYLOAD_BYTES]; /* data bytes; those after `length` have no meaning */
};

/* Room for one message: struct iovec. */
struct socket_vector {
    struct socket_frame *frame; /* where the kernel writes the frame */
    size_t bytes;               /* bytes that fit there */
};

/* struct msghdr of recvmsg(2). */
struct socket_header {
    uint8_t *name;                /* address of the sender; NULL: not wanted */
    uint32_t name_size;           /* bytes at `name`; 0 without it */
    struct socket_vector *vector; /* one */
    size_t vectors;               /* number of vectors: 1 */
    uint8_t *control;             /* aligned as a pointer is */
    size_t control_size;          /* bytes: room before, used after the call */
    int32_t flags;                /* MSG_TRUNC and others */
};

/* struct mmsghdr of recvmmsg(2). */
struct socket_message {
    struct socket_header head; /* buffers of the message */
    uint32_t size;             /* number of received bytes */
};

/* Two clocks at one instant, ns. */
struct socket_clock {
    int64_t real_ns;    /* clock of the kernel's stamps */
    int64_t now_ns;     /* monotonic clock */
    int64_t max_age_ns; /* longest time that a frame can have waited */
};

struct socket_counts {
    int64_t frames;     /* rows */
    int64_t malformed;  /* messages that are not CAN frames */
    int64_t errors;     /* error frames among the rows */
    int64_t dropped;    /* frames dropped by the kernel since the last call */
    int64_t drops_seen; /* last value of the kernel's drop counter, 32 bits, which wraps */
};

/* ---- what speaks against all drives at once (gateway/core/integrity.c) */

/* Missed ticks, lost frames, an intruder. Stamps are NO_TIME before the first event. */
struct integrity {
    /* constants */
    int64_t overrun_hold_ns;  /* time for which an overrun is reported */
    int64_t lost_hold_ns;     /* time for which lost frames make adhesion flags unknown */
    int64_t intruder_hold_ns; /* flags are unknown for so long after an intruder's last frame;
                                 INT64_MAX: until a restart */
    uint8_t authenticated;    /* 1: receivers can distinguish its frames from an intruder's */
    uint8_t stop_on_intruder; /* 1: the gateway falls silent once there is an intruder */
    /* notes of the driver for the next tick */
    int64_t missed_ticks; /* number of ticks skipped before that tick */
    int64_t lost_frames;  /* number of frames dropped unread since the last tick */
    uint8_t watching;     /* 1: frames with the gateway's identifiers can only be an intruder's */
    /* state */
    int64_t now_ns;          /* stamp of the last tick */
    int64_t deadline_misses; /* number of skipped ticks since the start */
    int64_t late_in_a_row;   /* consecutive ticks before which others were skipped */
    int64_t overrun_ns;      /* stamp of the last tick before which others were skipped */
    int64_t lost_ns;         /* stamp of the last tick before which frames were lost */
    int64_t intruder_ns;     /* stamp of the last tick with an intruder's frames */
    uint8_t intruder; /* 1: there was one. Latched: receivers cannot distinguish two senders */
    uint8_t silent;   /* 1: the gateway has stopped sending */
    uint8_t mute;     /* 1: this tick's frames are not sent: it was silent before */
};

/* ---- ticks as a report keeps them (gateway/core/tick_log.c) ---- */

/* One tick: values of the whole train. */
struct tick_row {
    int64_t t_ns;              /* stamp of the tick */
    double bus_load_percent;   /* NaN: not known */
    struct train_status train; /* what was published of all drives together */
};

/* One drive in one tick; NaN: not known. */
struct drive_row {
    struct drive_status status;     /* what was published of the drive */
    double degradation_k_h;         /* rate of degradation, K/h */
    double degradation_sigma_k_h;   /* standard deviation of that rate, K/h */
    double hours_to_limit;          /* h, until the motor is limit_k warmer than the others */
    double celsius[READING_POINTS]; /* degC, of a reading that came in this tick */
};

/* Log of ticks, in their order. */
struct tick_log {
    struct tick_row *ticks;   /* (capacity) */
    struct drive_row *drives; /* (capacity, drives) */
    int64_t capacity;         /* most ticks that fit */
    int64_t count;            /* number of logged ticks */
    double limit_k;           /* K by which a motor may grow warmer than the others */
};

#define TABLE_MAX_WORD     23
#define TABLE_MAX_DECIMALS 4
#define TABLE_MAX_FIELD 24 /* bytes of a field with its comma: a word, or 16 digits, point, sign */
#define TABLE_MAX_HEAD  48 /* bytes of time, node and line end */

/* A word of a table. */
struct table_word {
    uint8_t text[TABLE_MAX_WORD]; /* bytes of the word; the first `length` count */
    uint8_t length;               /* number of bytes */
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
    const int64_t *t_ns;                /* (ticks) */
    const int32_t *nodes;               /* (drive_count) */
    const struct table_column *columns; /* (column_count) columns after time and node */
    int32_t drive_count;                /* number of drives, and rows of one tick */
    int32_t column_count;               /* number of `columns` */
};

/* ---- the gateway (gateway/core/tick.c) ---- */

/* What comes next in a tick. */
enum tick_stage {
    STAGE_RECEIVE = 0, /* a new tick */
    STAGE_DETECT = 1,  /* a detector that is not in the core, then `finish_tick` */
};

/* All records of a gateway, by station, and the state of its ticks. */
struct gateway {
    struct receiver *receiver;             /* receiving stations */
    struct bus_load *load;                 /* load of the bus */
    struct integrity *integrity;           /* missed ticks, lost frames, an intruder */
    const struct drive_channels *channels; /* (drive_count) channels, and limits of the inputs */
    struct input_status *inputs;           /* (drive_count) validity of the inputs */
    struct estimator *estimator;           /* filters of the drives */
    struct drive_estimate *estimates;      /* (drive_count) estimates of this tick */
    struct motion_monitor *motion;         /* observers of load, and plausibility of the inputs */
    struct adhesion *adhesion;             /* adhesion station */
    struct temperature_monitor *temperatures; /* temperature monitor of all motors */
    const struct flag_rules *rules;    /* times and thresholds by which evidence changes flags */
    struct train_inputs *train_inputs; /* inputs of the flags that are common to all drives */
    struct flag_inputs *flag_inputs;   /* (drive_count) inputs of the flags of each drive */
    struct drive_evidence *evidence;   /* (drive_count) evidence of this tick */
    struct drive_status *status;       /* (drive_count) what is published of each drive */
    struct train_status *train;        /* what is published of all drives together */
    struct transmitter *transmitter;   /* transmitting station */
    /* constants */
    int64_t period_ns;     /* period of the loop */
    int32_t drive_count;   /* number of drives */
    uint8_t is_translated; /* 1: frames come from a translator; it counts the load of the bus */
    uint8_t detects;       /* 1: the detector is the core's own */
    /* result of a run */
    struct tx_frame *sent; /* frames of its ticks */
    int64_t sent_capacity; /* most that fit: at least those of a tick */
    int64_t sent_count;    /* number of frames that the run has sent */
    double *peak;          /* (drive_count) largest probability of loss; NaN: none */
    struct tick_log *log;  /* of its ticks; NULL: none is wanted */
    /* state */
    uint8_t stage;   /* enum tick_stage */
    uint8_t begun;   /* 1: there has been a tick */
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

/* Factors of variational message passing, or their prior; components and unit as above. */
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
    double offset;      /* K, offset of the sensor */
    double unrest;      /* K^2, variance of the model error */
    double noise;       /* K^2, variance of a reading */
    double usual;       /* degC, mean reading */
};

/* Settings of the filter. */
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
#define SWITCHING_TRIED 48 /* hypotheses that are weighed in one step: eight from each kept one */

/* Load of a drive over the demand of the train while it adheres: r + u. */
struct switching_ratio {
    double r;    /* lasting part: axle load, wheel, magnets */
    double u;    /* part that comes and goes: curves */
    double v_rr; /* variance of r */
    double v_ru; /* covariance of r and u */
    double v_uu; /* variance of u */
};

/* One drive under one hypothesis. */
struct switching_drive {
    double adhering;            /* probability that it adheres */
    double lost;                /* probability that it has lost adhesion */
    double neither;             /* probability that its load is meaningless; the three sum to 1 */
    double fresh;               /* share of `lost` whose c is new in this step */
    double fresh_neither;       /* share of `neither` whose c is new in this step */
    double c;                   /* load over the demand unless it adheres */
    double v_c;                 /* variance of c */
    double less;                /* probability that c is a share that a lost drive may carry */
    double precision;           /* information of its load about the demand: 1 / variance */
    double shift;               /* the same: mean / variance */
    struct switching_ratio now; /* load ratio if it adheres */
    struct switching_ratio before; /* load ratio when it last adhered, if it does not */
};

/* One hypothesis of the history of the demand and of all drives. */
struct switching_hypothesis {
    double log_weight; /* logarithm of its probability */
    double m;          /* demand */
    double s;          /* change of the demand in a step */
    double v_mm;       /* variance of m */
    double v_ms;       /* covariance of m and s */
    double v_ss;       /* variance of s */
};

/* Load of one drive in this step. */
struct switching_load {
    double load;     /* load of the drive */
    double gain;     /* the learnt noise counts (1 + gain) times: a scaled load has more */
    double error;    /* standard deviation of known errors other than noise */
    double sigma;    /* estimated standard deviation of the load: its noise until that is learnt */
    uint8_t known;   /* 1: `load` is a number */
    uint8_t apart;   /* 1: its wheel runs apart from the others and is no measure for them */
    uint8_t unsure;  /* 1: its wheel may not adhere: nothing is learnt from it */
    uint8_t source;  /* 0: load of the filter, 1: of the observer; each has its own noise */
    uint8_t answers; /* 1: it carried what it was asked for, in the tick before */
};

/* Noise of one drive's load around its expected value. */
struct switching_noise {
    double variance; /* learnt variance */
    double lag;      /* additional standard deviation while the demand moves */
    double learnt_s; /* time for which `variance` has been learnt, s */
    double lasting;  /* mean recent error, in standard deviations: a lasting error is no noise */
    double scatter;  /* limit of two thirds of the error's changes within SWITCHING_PAST steps */
    double past[SWITCHING_PAST]; /* errors of the last steps, a ring */
    int32_t at;                  /* index of the oldest error */
    int32_t count;               /* number of errors in `past` */
    uint8_t source;              /* `source` of the loads that this was learnt from */
};

/* State of the switching model; `switching_reset` sets it to nothing known. */
struct switching {
    int32_t n;                      /* number of drives */
    int32_t every;                  /* ticks in a step of 10 ms, at least 1 */
    int32_t ticks;                  /* number of ticks since the last step */
    int32_t kept;                   /* number of hypotheses */
    int32_t contradicted;           /* consecutive steps in which most loads were meaningless */
    struct switching_load *loads;   /* (n,) input */
    struct switching_noise *noises; /* (n,) learnt noise of each load */
    struct switching_hypothesis *hypotheses; /* (SWITCHING_KEPT,), the first `kept` */
    struct switching_drive *drives;          /* (SWITCHING_KEPT, n) */
    struct switching_hypothesis *trials;     /* (SWITCHING_TRIED,) workspace */
    struct switching_drive *trial_drives;    /* (SWITCHING_TRIED + 1, n) workspace */
    double *adhering;                        /* (n,) probability of adhering, over all hypotheses */
    double *lost;                            /* (n,) probability of a loss, over all hypotheses */
    double demand;                           /* mean demand, over all hypotheses */
};

#endif
