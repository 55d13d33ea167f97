/* Sine, cosine and arc tangent by the polynomials of fdlibm (k_sin.c, k_cos.c, s_atan.c).
 *
 * No divisor here is 0 unless a comment says so; infinity and NaN come out as NaN. */
#include "estimators/trigonometry.h"

#include <math.h>

#include "estimators/trigonometry_terms.h"

static const double PI = 0x1.921fb54442d18p+1;
static const double PI_2 = 0x1.921fb54442d18p+0;
static const double PI_2_REST = 0x1.1a62633145c07p-54; /* pi / 2 less PI_2 */

/* sin(angle + shift pi / 2). */
static double sine_of_shifted(double angle, double shift)
{
    const double quarters = floor(angle * TWO_OVER_PI + 0.5);
    const double r = (angle - quarters * PI_2_HIGH) - quarters * PI_2_LOW;
    const double z = r * r;
    const double turned = quarters + shift;
    const double quadrant = turned - 4.0 * floor(turned * 0.25); /* 0, 1, 2 or 3 */
    const int is_odd = quadrant == 1.0 || quadrant == 3.0;
    const double size = is_odd ? COSINE_KERNEL(z) : SINE_KERNEL(r, z);
    return quadrant >= 2.0 ? -size : size;
}

double sine(double angle)
{
    return sine_of_shifted(angle, 0.0);
}

double cosine(double angle)
{
    return sine_of_shifted(angle, 1.0);
}

/* atan t - t, |t| <= 7/16. */
static double arc_kernel(double t)
{
    static const double TERMS[] = {
        1.62858201153657823623e-02,  -3.65315727442169155270e-02, 4.97687799461593236017e-02,
        -5.83357013379057348645e-02, 6.66107313738753120669e-02,  -7.69187620504482999495e-02,
        9.09088713343650656196e-02,  -1.11111104054623557880e-01, 1.42857142725034663711e-01,
        -1.99999999998764832476e-01, 3.33333333333329318027e-01,
    };
    const double z = t * t;
    double sum = 0.0;
    for (unsigned k = 0; k < sizeof TERMS / sizeof TERMS[0]; k++)
        sum = TERMS[k] + z * sum;
    return -t * z * sum;
}

/* atan t, 0 <= t <= 1: about 0, 1/2 or 1. The divisors are at least 1. */
static double arc_of_ratio(double t)
{
    static const double HALF = 4.63647609000806093515e-01, HALF_REST = 2.26987774529616870924e-17;
    if (t < 0.4375)
        return t + arc_kernel(t);
    if (t < 0.6875) {
        const double u = (2.0 * t - 1.0) / (2.0 + t);
        return HALF + ((HALF_REST + arc_kernel(u)) + u);
    }
    const double u = (t - 1.0) / (t + 1.0);
    return 0.5 * PI_2 + ((0.5 * PI_2_REST + arc_kernel(u)) + u);
}

double arc_tangent(double y, double x)
{
    const double a = fabs(x), b = fabs(y);
    if (a == 0.0 && b == 0.0)
        return 0.0;
    double angle; /* of (a, b), from 0 to pi / 2; the divisor is the larger one, above 0 */
    if (b <= a)
        angle = arc_of_ratio(b / a);
    else
        angle = PI_2 - (arc_of_ratio(a / b) - PI_2_REST);
    if (x < 0.0)
        angle = PI - (angle - 2.0 * PI_2_REST);
    return y < 0.0 ? -angle : angle;
}

double wrap_angle(double angle)
{
    return angle - 2.0 * PI * ceil((angle - PI) / (2.0 * PI));
}
