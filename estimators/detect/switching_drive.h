/* One drive under one hypothesis: what its load says of its state and of the demand. */
#ifndef TRACTION_SWITCHING_DRIVE_H
#define TRACTION_SWITCHING_DRIVE_H

#include "gateway/core/records.h"

#define STEP_S 0.01 /* the model moves in steps of this length */
#define STRAY  1e-8 /* probability per step that a load begins to mean nothing */
#define R_MOST 0.3  /* r stays so near to 1 */
#define SPAN   3.0  /* loads and demands lie within such a range, -1.5 to 1.5 */

/* Mean and variance of the demand. */
struct gaussian {
    double m, v;
};

/* Joint probabilities of a load and of what it came from. */
struct origins {
    double adhering; /* of a drive that adheres, */
    double outlier;  /* the same with a wide error, */
    double held;     /* of one that is lost and carries the share of before, */
    double fresh;    /* of one that is lost and carries anything, */
    double steady;   /* of one whose load means nothing, and is the share of before, */
    double neither;  /* or anything; */
    double all;      /* their sum: above 0 */
};

/* Before anything is known. */
struct switching_drive switching_drive_unknown(void);

/* r + u, and its variance. */
double ratio_of(const struct switching_ratio *q);
double ratio_variance(const struct switching_ratio *q);

/* Mean of two, weighted: moments of the mixture. */
struct switching_ratio mix_ratios(const struct switching_ratio *a, double w_a,
                                  const struct switching_ratio *b, double w_b);

/* A step of time. begin: probability that a drive which adheres loses adhesion. */
void switching_drive_predict(struct switching_drive *d, double begin);

/* Where a load y may come from; g: demand by everything else; noise: variance, above 0. */
struct origins switching_drive_explain(const struct switching_drive *d, double y, double noise,
                                       struct gaussian g);

/* The demand with this load: moments of the mixture over its origins. */
struct gaussian switching_drive_absorb(const struct switching_drive *d, double y, double noise,
                                       struct gaussian g, const struct origins *from);

/* States and share with this load; and the ratio, unless the wheel may not adhere (`unsure`). */
void switching_drive_update(struct switching_drive *d, double y, double noise, struct gaussian g,
                            const struct origins *from, int unsure);

#endif
