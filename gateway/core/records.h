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

#endif
