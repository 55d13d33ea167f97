/* One drive under one hypothesis: what its load shows of its state and of the demand. */
#ifndef TRACTION_SWITCHING_DRIVE_H
#define TRACTION_SWITCHING_DRIVE_H

#include "gateway/core/records.h"

#define STEP_S 0.01 /* duration of a step of the model, s */
#define STRAY  1e-8 /* probability per step that a load becomes meaningless */
#define R_MOST 0.3  /* largest distance of r from 1 */
#define SPAN   3.0  /* width of the range of loads and demands, -1.5 to 1.5 */

/* Mean and variance of the demand. */
struct gaussian {
    double m, v;
};

/* Joint probabilities of a load and of its origin. */
struct origins {
    double adhering; /* the drive adheres */
    double outlier;  /* the same, with a wide error */
    double held;     /* the drive is lost and carries the share of before */
    double fresh;    /* the drive is lost and carries any share */
    double steady;   /* the load is meaningless and is the share of before */
    double neither;  /* the load is meaningless and may be anything */
    double all;      /* sum of these: above 0 */
};

/* State before anything is known. */
struct switching_drive switching_drive_unknown(void);

/* r + u, and its variance. */
double ratio_of(const struct switching_ratio *q);
double ratio_variance(const struct switching_ratio *q);

/* Weighted mean of two ratios: moments of the mixture. */
struct switching_ratio mix_ratios(const struct switching_ratio *a, double w_a,
                                  const struct switching_ratio *b, double w_b);

/* Predict a step. begin: probability that a drive that adheres loses adhesion. */
void switching_drive_predict(struct switching_drive *d, double begin);

/* Origins of a load y; g: demand by everything else; noise: variance, above 0. */
struct origins switching_drive_explain(const struct switching_drive *d, double y, double noise,
                                       struct gaussian g);

/* Update the demand with this load: moments of the mixture over its origins. */
struct gaussian switching_drive_absorb(const struct switching_drive *d, double y, double noise,
                                       struct gaussian g, const struct origins *from);

/* Update states and share with this load; also the ratio unless `unsure`: it may not adhere. */
void switching_drive_update(struct switching_drive *d, double y, double noise, struct gaussian g,
                            const struct origins *from, int unsure);

#endif
