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

#endif
