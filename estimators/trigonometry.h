/* Sine, cosine and arc tangent: the same bits on every machine, unlike libm's. */
#ifndef TRACTION_TRIGONOMETRY_H
#define TRACTION_TRIGONOMETRY_H

/* For an angle of up to 1e6 rad, error below 3e-16; for a larger one the number has no meaning. */
double sine(double angle);
double cosine(double angle);
void sine_and_cosine(double angle, double *sin, double *cos);

/* Angle of the vector (x, y) in [-pi, pi], rad, error below 4e-16; 0 for (0, 0), NaN for NaN. */
double arc_tangent(double y, double x);

/* `angle` wrapped to (-pi, pi]. */
double wrap_angle(double angle);

#endif
