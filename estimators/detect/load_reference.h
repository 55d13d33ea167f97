/* Load of each drive while it adheres. All loads are per unit of rated torque. */
#ifndef TRACTION_LOAD_REFERENCE_H
#define TRACTION_LOAD_REFERENCE_H

#include "gateway/core/records.h"

/* Learning period, s: errors of the load estimate that are closer in time are not independent. */
extern const double LEARN_PERIOD_S;

/* Reset n drives to nothing learnt; `spread`: standard deviation of a healthy load. */
void load_reference_reset(struct load_spread *all, struct load_ratio *drives, int n, double spread);

/* Load of a drive as if all drives were equal and fully commanded; share: of full command. */
double normalise_load(const struct load_ratio *drive, double load, double share);

/* Standard deviation of the normalised load of a healthy drive around the common one. transient:
 * relative standard deviation of changes that are too quick to be learnt. */
double normalised_sigma(const struct load_spread *all, const struct load_ratio *drive, double load,
                        double share, double transient);

/* Learn the spread from one observation, LEARN_PERIOD_S after the last one; also from lost drives.
 * relative: 1 if `common` is the mean of the drives themselves, which follows each of them. */
void update_spread(struct load_spread *all, struct load_ratio *drives,
                   const struct load_observation *observed, int n, int relative);

/* Learn the ratios from one observation of drives that certainly adhere (`healthy`).
 * relative: 1 if only differences between the drives are observable; then their mean stays 1. */
void update_ratios(const struct load_spread *all, struct load_ratio *drives,
                   const struct load_observation *observed, int n, int relative);

#endif
