/* Load of a drive from its measured speed and torque. */
#ifndef TRACTION_LOAD_OBSERVER_H
#define TRACTION_LOAD_OBSERVER_H

#include "gateway/core/records.h"

/* Start at a reading: speed w, rad/s, and torque, Nm. A train is heavy: until its acceleration is
 * known the load is taken to be the torque, with half of it as standard deviation. */
void load_observer_init(struct load_observer *state, double w, double torque,
                        const struct mechanics *m);

/* Add a reading, dt s (above 0) after the last one. Finite inputs give finite results. */
void load_observer_update(struct load_observer *state, double w, double torque, double dt,
                          const struct mechanics *m);

/* Standard deviation of the load, Nm. P allows for a wheel that slips; innovations that are smaller
 * than P predicts show that the load is known better, larger ones that it is known worse. */
double load_observer_sigma(const struct load_observer *state);

#endif
