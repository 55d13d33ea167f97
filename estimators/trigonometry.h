/* Sine, cosine and arc tangent: the same bits on every machine, unlike libm's. */
#ifndef TRACTION_TRIGONOMETRY_H
#define TRACTION_TRIGONOMETRY_H

/* Of an angle of up to 1e6 rad, error below 3e-16; of a larger one a number without meaning. */
double sine(double angle);
double cosine(double angle);
void sine_and_cosine(double angle, double *sin, double *cos);

/* Angle of the vector (x, y) in [-pi, pi], rad, error below 4e-16; 0 of (0, 0), NaN of NaN. */
double arc_tangent(double y, double x);

/* `angle` in (-pi, pi]. */
double wrap_angle(double angle);

#endif
