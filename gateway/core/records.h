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

/* ---- Temperatures of the motors, and their thermal model ---- */

#define THERMAL_POINTS 3 /* with a sensor: stator winding, drive end, non-drive end */
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
    double sigma[IMM_DISTURBANCES];    /* standard deviations of the disturbances */
    double benign_k[IMM_MODES - 1];    /* K, smaller faults of each kind are none */
    double shown_k;                    /* K, that heat has to have made of some reading */
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

/* Kind of a thermal or sensor fault, as on the bus. */
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

/* Sensor that a sensor fault is on, as on the bus; THERMAL_POINTS are 1 to 3. */
enum fault_sensor {
    FAULT_SENSOR_NONE = 0,
    FAULT_SENSOR_STATOR = 1,
    FAULT_SENSOR_DRIVE_END = 2,
    FAULT_SENSOR_NON_DRIVE_END = 3,
    FAULT_SENSOR_AMBIENT = 4,
    FAULT_SENSOR_CURRENT = 5,
};

/* One temperature sensor; the first three are constants. Stamps are INT64_MIN before any. */
struct temperature_sensor {
    double limit_k;         /* K, a change beyond it that stays is an offset */
    int64_t stuck_after_ns; /* a value held for longer is a stuck sensor's */
    uint8_t configured;     /* 1: the drive has this sensor */
    uint8_t seen;           /* 1: there was a valid value */
    uint8_t saturated;      /* 1: it has warmed up to the signal's maximum, and may stay there */
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

#endif
