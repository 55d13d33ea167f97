/* What the load of each drive is while it adheres. All loads per unit of rated torque. */
#ifndef TRACTION_LOAD_REFERENCE_H
#define TRACTION_LOAD_REFERENCE_H

#include "gateway/core/records.h"

/* Errors of the load estimate are independent only this far apart, s: so often is learnt. */
extern const double LEARN_PERIOD_S;

/* Nothing learnt of n drives; `spread`: standard deviation of a healthy load. */
void load_reference_reset(struct load_spread *all, struct load_ratio *drives, int n, double spread);

/* The load of a drive as if all drives were equal and fully commanded; share: of full command. */
double normalise_load(const struct load_ratio *drive, double load, double share);

/* Standard deviation of the normalised load of a healthy drive around the common one. transient:
 * relative standard deviation of what passes too quickly to be learnt. */
double normalised_sigma(const struct load_spread *all, const struct load_ratio *drive, double load,
                        double share, double transient);

/* Learn the spread from one observation, LEARN_PERIOD_S after the last; lost drives included.
 * relative: `common` is the mean of the drives themselves, which follows each of them. */
void update_spread(struct load_spread *all, struct load_ratio *drives,
                   const struct load_observation *observed, int n, int relative);

/* Learn the ratios from one observation of drives that certainly adhere (`healthy`).
 * relative: only differences between the drives are observable, their mean stays 1. */
void update_ratios(const struct load_spread *all, struct load_ratio *drives,
                   const struct load_observation *observed, int n, int relative);

#endif
