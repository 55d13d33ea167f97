/* Sine, cosine and arc tangent by the polynomials of fdlibm (k_sin.c, k_cos.c, s_atan.c).
 *
 * No divisor here is 0 unless a comment says so; infinity and NaN give NaN. */
#include "estimators/trigonometry.h"

#include <math.h>
#include <stdint.h>

#include "estimators/trigonometry_terms.h"

static const double PI = 0x1.921fb54442d18p+1;
static const double PI_2 = 0x1.921fb54442d18p+0;
static const double PI_2_REST = 0x1.1a62633145c07p-54; /* pi / 2 less PI_2 */

void sine_and_cosine(double angle, double *sin, double *cos)
{
    static const double TO_INTEGER =
        0x1.8p52; /* added and subtracted: rounds to the next integer */
    const union {
        double number;
        uint64_t bits; /* the last two give the quadrant */
    } shifted = {angle * TWO_OVER_PI + TO_INTEGER};
    const double quarters = shifted.number - TO_INTEGER;
    const double r = (angle - quarters * PI_2_HIGH) - quarters * PI_2_LOW;
    const double z = r * r;
    const double kernel[2] = {SINE_KERNEL(r, z), COSINE_KERNEL(z)};
    static const double SIGN[4] = {1.0, 1.0, -1.0, -1.0};
    const unsigned quadrant = shifted.bits & 3;
    *sin = SIGN[quadrant] * kernel[quadrant & 1];
    *cos = SIGN[(quadrant + 1) & 3] * kernel[~quadrant & 1];
}

double sine(double angle)
{
    double sin, cos;
    sine_and_cosine(angle, &sin, &cos);
    return sin;
}

double cosine(double angle)
{
    double sin, cos;
    sine_and_cosine(angle, &sin, &cos);
    return cos;
}

/* atan t - t, |t| <= 7/16; even and odd terms of the polynomial in parallel. */
static double arc_kernel(double t)
{
    static const double EVEN[] = {3.33333333333329318027e-01, 1.42857142725034663711e-01,
                                  9.09088713343650656196e-02, 6.66107313738753120669e-02,
                                  4.97687799461593236017e-02, 1.62858201153657823623e-02};
    static const double ODD[] = {-1.99999999998764832476e-01, -1.11111104054623557880e-01,
                                 -7.69187620504482999495e-02, -5.83357013379057348645e-02,
                                 -3.65315727442169155270e-02};
    const double z = t * t, z2 = z * z;
    double even = EVEN[5], odd = ODD[4];
    for (int k = 4; k > 0; k--) {
        even = even * z2 + EVEN[k];
        odd = odd * z2 + ODD[k - 1];
    }
    return -t * z * (even * z2 + EVEN[0] + z * odd);
}

/* Angle of the vector (a, b), 0 <= b <= a, 0 < a: turned back by an angle of tangent 0, 1/2 or 1, so
 * that the remaining tangent is at most 7/16. The divisor is above 0. */
static double arc_of(double a, double b)
{
    static const double X[] = {1.0, 2.0, 1.0}, Y[] = {0.0, 1.0, 1.0};
    static const double ANGLE[] = {0.0, 4.63647609000806093515e-01, 0x1.921fb54442d18p-1};
    static const double REST[] = {0.0, 2.26987774529616870924e-17, 0x1.1a62633145c07p-55};
    const int k = (b >= 0.4375 * a) + (b >= 0.6875 * a);
    const double t = (X[k] * b - Y[k] * a) / (X[k] * a + Y[k] * b);
    return ANGLE[k] + ((REST[k] + arc_kernel(t)) + t);
}

double arc_tangent(double y, double x)
{
    const double a = fabs(x), b = fabs(y);
    if (a == 0.0 && b == 0.0)
        return 0.0;
    double angle; /* of (a, b), from 0 to pi / 2 */
    if (b <= a)
        angle = arc_of(a, b);
    else
        angle = PI_2 - (arc_of(b, a) - PI_2_REST);
    if (x < 0.0)
        angle = PI - (angle - 2.0 * PI_2_REST);
    return y < 0.0 ? -angle : angle;
}

double wrap_angle(double angle)
{
    if (-PI < angle && angle <= PI)
        return angle;
    return angle - 2.0 * PI * ceil((angle - PI) / (2.0 * PI));
}
