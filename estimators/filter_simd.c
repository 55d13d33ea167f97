/* Extended and unscented Kalman filter of several drives at once: paper `adhesion`, eq. (11)-(13).
 *
 * Drives are independent and do the same arithmetic: one instruction serves SIMD_WIDTH drives, one
 * lane each. This file is compiled once per instruction set (filter_simd_avx2.c, filter_simd_avx512.c
 * and itself); every build gives the same bits, as no product is fused with a sum and no sum crosses
 * lanes. x = [i_alpha, i_beta, w_e, theta_e, T_L]; P is its upper triangle, row by row.
 *
 * No function here can fail. Divisors are constants of the motor; a divisor of 0 or NaN gives a
 * lane that is not committed: a filter whose result is not finite, or has a negative variance,
 * keeps its last good state. Indices are bounded by the lanes, or are links made here.
 *
 * Longer than other files, because each build is one translation unit: shared functions of the
 * filters are inline, so that no lane goes through memory between two functions. */
#include "estimators/filter_simd.h"

#include <complex.h>
#include <float.h>
#include <math.h>
#include <stddef.h>

#ifndef SIMD_WIDTH
#define SIMD_WIDTH 2 /* doubles in a register of x86-64 and AArch64 */
#define SIMD_NAME  filter_run_128
#endif
#include "estimators/lanes.h"

enum { STATES = 5, TRIANGLE = 15 };

static const double TWO_PI = 0x1.921fb54442d18p+2;
static const double TURN_MAX = 1.4; /* half a sample's turn, rad, up to which a voltage turns */
static const double FLOOR = 1e-12;  /* least variance */
static const double REPAIR = 1e-6;  /* relative increase of the variances of a P without a factor */

/* x, and the upper triangle of P, row by row. */
struct state {
    vec x[STATES], P[TRIANGLE];
};
static const int VARIANCES[STATES] = {0, 5, 9, 12, 14}; /* in P */

/* The filters of up to LANES drives. */
struct block {
    struct state now;
    vec a, b, d, e, f;          /* theta_a, theta_b, theta_d, theta_e, -theta_f of eq. (12) */
    vec dt_L;                   /* dt / L_s */
    vec Q[STATES], R[2], coast; /* noise: `struct filter_noise`, R scaled */
    vec bias;                   /* v_q_bias, V */
    vec u[2], y[2];             /* voltage and current of the sample */
    vec v[2];                   /* dt / L_s times the voltage of the sub-step */
    vec cos_v, sin_v;           /* its turn from one sub-step to the next */
    vec sin, cos;               /* of theta_e, before a sub-step of the EKF */
    vec nis;
    vec kappa_J, p_J, B_J; /* k_p p^2 psi_f / J, p / J, B / J: for the prediction over a gap */
    mask has_root;         /* every P has had a Cholesky factor */
};

static inline vec wrap(vec angle)
{
    const vec turns = (angle * (1.0 / TWO_PI) + TO_INTEGER) - TO_INTEGER;
    return angle - TWO_PI * turns;
}

/* The voltage of the first sub-step, and its turn per sub-step.
 *
 * The voltage of an inverter turns with the rotor, but only its mean u over n sub-steps is known:
 * u_j = u n sin(h) / sin(n h) exp(i 2 h (j - (n - 1) / 2)), h = w dt / 2, where |n h| <= TURN_MAX. */
static inline void turn_voltage(struct block *s, int64_t n_sub, double dt)
{
    const double n = (double)n_sub;
    const vec w = s->now.x[2];
    vec sin, cos;
    sine_cosine(s->now.x[3] + 0.5 * n * dt * w, &sin, &cos);
    const vec u0 = s->u[0] + s->bias * sin;
    const vec u1 = s->u[1] - s->bias * cos;
    s->v[0] = s->dt_L * u0;
    s->v[1] = s->dt_L * u1;
    s->cos_v = broadcast(1.0);
    s->sin_v = broadcast(0.0);
    if (n_sub == 1)
        return;
    const vec h = 0.5 * dt * w;
    vec sin_h, cos_h, sin_n, cos_n, sin_b, cos_b;
    sine_cosine(h, &sin_h, &cos_h);
    sine_cosine(n * h, &sin_n, &cos_n);
    sine_cosine(-h * (n - 1.0), &sin_b, &cos_b);
    const mask turns = (h != 0.0) & (absolute(n * h) <= TURN_MAX);
    const vec gain = n * sin_h / select(turns, sin_n, broadcast(1.0));
    s->v[0] = s->dt_L * select(turns, gain * (cos_b * u0 - sin_b * u1), u0);
    s->v[1] = s->dt_L * select(turns, gain * (sin_b * u0 + cos_b * u1), u1);
    s->cos_v = select(turns, 1.0 - 2.0 * sin_h * sin_h, broadcast(1.0));
    s->sin_v = select(turns, 2.0 * sin_h * cos_h, broadcast(0.0));
}

static inline void next_voltage(struct block *s)
{
    const vec v0 = s->v[0], v1 = s->v[1];
    s->v[0] = s->cos_v * v0 - s->sin_v * v1;
    s->v[1] = s->sin_v * v0 + s->cos_v * v1;
}

/* x <- f(x, u), eq. (12), of one sub-step; the angle is not wrapped. */
static inline void propagate(struct block *s, vec sin, vec cos, double dt)
{
    const vec i_a = s->now.x[0], i_b = s->now.x[1], w = s->now.x[2];
    s->now.x[0] = s->a * i_a + s->b * sin * w + s->v[0];
    s->now.x[1] = s->a * i_b - s->b * cos * w + s->v[1];
    s->now.x[2] = s->d * w + (s->e * cos * i_b - s->e * sin * i_a) + s->f * s->now.x[4];
    s->now.x[3] = s->now.x[3] + w * dt;
    next_voltage(s);
}

/* EKF, one sub-step: P <- F P F' + Q with F of eq. (13), its entries other than 0 and 1 written out;
 * m is F P. The angle after the sub-step is known before P, and so are its sine and cosine, so that
 * they do not wait for P; `last`: they are not needed. */
static inline void predict_extended(struct block *s, double dt, int last)
{
    const vec a = s->a, b = s->b, e = s->e, f22 = s->d, f24 = s->f, *Q = s->Q;
    const vec i_a = s->now.x[0], i_b = s->now.x[1], w = s->now.x[2];
    vec *P = s->now.P;
    const vec p00 = P[0], p01 = P[1], p02 = P[2], p03 = P[3], p04 = P[4];
    const vec p11 = P[5], p12 = P[6], p13 = P[7], p14 = P[8];
    const vec p22 = P[9], p23 = P[10], p24 = P[11];
    const vec p33 = P[12], p34 = P[13], p44 = P[14];
    const vec sin = s->sin, cos = s->cos;
    if (!last)
        sine_cosine(s->now.x[3] + w * dt, &s->sin, &s->cos);
    const vec f02 = b * sin, f12 = -b * cos;
    const vec f03 = b * cos * w, f13 = b * sin * w;
    const vec f20 = -e * sin, f21 = e * cos;
    const vec f23 = f20 * i_b - f21 * i_a;

    const vec m00 = a * p00 + f02 * p02 + f03 * p03;
    const vec m01 = a * p01 + f02 * p12 + f03 * p13;
    const vec m02 = a * p02 + f02 * p22 + f03 * p23;
    const vec m03 = a * p03 + f02 * p23 + f03 * p33;
    const vec m04 = a * p04 + f02 * p24 + f03 * p34;
    const vec m11 = a * p11 + f12 * p12 + f13 * p13;
    const vec m12 = a * p12 + f12 * p22 + f13 * p23;
    const vec m13 = a * p13 + f12 * p23 + f13 * p33;
    const vec m14 = a * p14 + f12 * p24 + f13 * p34;
    const vec m20 = f20 * p00 + f21 * p01 + f22 * p02 + f23 * p03 + f24 * p04;
    const vec m21 = f20 * p01 + f21 * p11 + f22 * p12 + f23 * p13 + f24 * p14;
    const vec m22 = f20 * p02 + f21 * p12 + f22 * p22 + f23 * p23 + f24 * p24;
    const vec m23 = f20 * p03 + f21 * p13 + f22 * p23 + f23 * p33 + f24 * p34;
    const vec m24 = f20 * p04 + f21 * p14 + f22 * p24 + f23 * p34 + f24 * p44;
    const vec m32 = dt * p22 + p23, m33 = dt * p23 + p33, m34 = dt * p24 + p34;

    P[0] = a * m00 + f02 * m02 + f03 * m03 + Q[0];
    P[1] = a * m01 + f12 * m02 + f13 * m03;
    P[2] = a * m20 + f02 * m22 + f03 * m23; /* as P is symmetric */
    P[3] = dt * m02 + m03;
    P[4] = m04;
    P[5] = a * m11 + f12 * m12 + f13 * m13 + Q[1];
    P[6] = a * m21 + f12 * m22 + f13 * m23;
    P[7] = dt * m12 + m13;
    P[8] = m14;
    P[9] = f20 * m20 + f21 * m21 + f22 * m22 + f23 * m23 + f24 * m24 + Q[2];
    P[10] = dt * m22 + m23;
    P[11] = m24;
    P[12] = dt * m32 + m33 + Q[3];
    P[13] = m34;
    P[14] = p44 + Q[4];
    propagate(s, sin, cos, dt);
}

/* Lower Cholesky factor of P, its columns one after the other; of the variances `diagonal`. */
struct factor {
    vec l00, l10, l20, l30, l40, l11, l21, l31, l41, l22, l32, l42, l33, l43, l44;
    mask good; /* 1 if every pivot is above 0 */
};

static inline vec pivot(vec value, mask *good)
{
    const mask positive = value > 0.0;
    *good &= positive;
    return square_root(select(positive, value, broadcast(1.0)));
}

static inline struct factor factor_of(const vec *P, const vec *diagonal)
{
    struct factor l;
    l.good = ~(mask){0};
    l.l00 = pivot(diagonal[0], &l.good);
    const vec r0 = 1.0 / l.l00; /* a root above 0, as are those below */
    l.l10 = P[1] * r0;
    l.l20 = P[2] * r0;
    l.l30 = P[3] * r0;
    l.l40 = P[4] * r0;
    l.l11 = pivot(diagonal[1] - l.l10 * l.l10, &l.good);
    const vec r1 = 1.0 / l.l11;
    l.l21 = (P[6] - l.l20 * l.l10) * r1;
    l.l31 = (P[7] - l.l30 * l.l10) * r1;
    l.l41 = (P[8] - l.l40 * l.l10) * r1;
    l.l22 = pivot(diagonal[2] - l.l20 * l.l20 - l.l21 * l.l21, &l.good);
    const vec r2 = 1.0 / l.l22;
    l.l32 = (P[10] - l.l30 * l.l20 - l.l31 * l.l21) * r2;
    l.l42 = (P[11] - l.l40 * l.l20 - l.l41 * l.l21) * r2;
    l.l33 = pivot(diagonal[3] - l.l30 * l.l30 - l.l31 * l.l31 - l.l32 * l.l32, &l.good);
    const vec r3 = 1.0 / l.l33;
    l.l43 = (P[13] - l.l40 * l.l30 - l.l41 * l.l31 - l.l42 * l.l32) * r3;
    l.l44 =
        pivot(diagonal[4] - l.l40 * l.l40 - l.l41 * l.l41 - l.l42 * l.l42 - l.l43 * l.l43, &l.good);
    return l;
}

/* The factor; if P has none and `repaired` is set, that of P with increased variances. */
static inline struct factor factor_or_repair(struct block *s, int repaired)
{
    const vec *P = s->now.P;
    const vec diagonal[STATES] = {P[0], P[5], P[9], P[12], P[14]};
    const struct factor first = factor_of(P, diagonal);
    if (!repaired) {
        s->has_root &= first.good;
        return first;
    }
    vec raised[STATES];
    for (int i = 0; i < STATES; i++) {
        const vec more = diagonal[i] + (REPAIR * absolute(diagonal[i]) + FLOOR);
        raised[i] = select(first.good, diagonal[i], more);
    }
    const struct factor second = factor_of(P, raised);
    s->has_root &= second.good;
    return second;
}

/* Odd part o and even part ev of the image of a pair of sigma points, +-(d_a, d_b, d_w, d_t, d_l)
 * off the mean: the deviations from the image of the mean are ev + o and ev - o. */
struct pair {
    vec o_a, o_b, o_w, ev_a, ev_b, ev_w;
};

static inline struct pair pair_of(const struct block *s, vec sin, vec cos, vec d_a, vec d_b,
                                  vec d_w, vec d_t, vec d_l)
{
    const vec b = s->b, e = s->e, i_a = s->now.x[0], i_b = s->now.x[1], w = s->now.x[2];
    vec sin_d, cos_d;
    sine_cosine(d_t, &sin_d, &cos_d);
    const vec even_s = sin * cos_d, odd_s = cos * sin_d;
    const vec even_c = cos * cos_d, odd_c = -sin * sin_d;
    return (struct pair){
        .o_a = s->a * d_a + b * (w * odd_s + d_w * even_s),
        .ev_a = b * (w * (even_s - sin) + d_w * odd_s),
        .o_b = s->a * d_b - b * (w * odd_c + d_w * even_c),
        .ev_b = -b * (w * (even_c - cos) + d_w * odd_c),
        .o_w =
            s->d * d_w + e * (i_b * odd_c + d_b * even_c - i_a * odd_s - d_a * even_s) + s->f * d_l,
        .ev_w = e * (i_b * (even_c - cos) + d_b * odd_c - i_a * (even_s - sin) - d_a * odd_s),
    };
}

/* Images of the five pairs of sigma points after a sub-step; angle and load are linear. */
struct points {
    struct pair q[4];
    vec o_w4, o_t[4], o_l[5]; /* o_w4: of the fifth pair */
};

/* Mean's shift (s_a, s_b, s_w, 0, 0) and P of the points: with the shift s, a pair gives
 *     (ev + o - s)(ev + o - s)' + (ev - o - s)(ev - o - s)' = 2 (o o' + (ev - s)(ev - s)').
 * The fifth pair moves only the load: its ev is zero. */
static inline void merge_points(struct block *s, const struct points *points, double kappa,
                                vec *shift)
{
    const double two = 1.0 / (5.0 + kappa), weight_0 = kappa / (5.0 + kappa);
    const struct pair *q = points->q;
    const vec zero = broadcast(0.0), *Q = s->Q;
    const vec o_w4 = points->o_w4, *o_t = points->o_t, *o_l = points->o_l;
    const vec s_a = two * (q[0].ev_a + q[1].ev_a + q[2].ev_a + q[3].ev_a);
    const vec s_b = two * (q[0].ev_b + q[1].ev_b + q[2].ev_b + q[3].ev_b);
    const vec s_w = two * (q[0].ev_w + q[1].ev_w + q[2].ev_w + q[3].ev_w);
    vec aa = s_a * s_a, ab = s_a * s_b, aw = s_a * s_w, bb = s_b * s_b, bw = s_b * s_w;
    vec ww = s_w * s_w + o_w4 * o_w4, at = zero, al = zero, bt = zero, bl = zero, wt = zero;
    vec wl = o_w4 * o_l[4], tt = zero, tl = zero, ll = o_l[4] * o_l[4];
    for (int j = 0; j < 4; j++) {
        const vec o_a = q[j].o_a, o_b = q[j].o_b, o_w = q[j].o_w;
        const vec a = q[j].ev_a - s_a, b = q[j].ev_b - s_b, w = q[j].ev_w - s_w;
        aa += o_a * o_a + a * a;
        ab += o_a * o_b + a * b;
        aw += o_a * o_w + a * w;
        at += o_a * o_t[j];
        al += o_a * o_l[j];
        bb += o_b * o_b + b * b;
        bw += o_b * o_w + b * w;
        bt += o_b * o_t[j];
        bl += o_b * o_l[j];
        ww += o_w * o_w + w * w;
        wt += o_w * o_t[j];
        wl += o_w * o_l[j];
        tt += o_t[j] * o_t[j];
        tl += o_t[j] * o_l[j];
        ll += o_l[j] * o_l[j];
    }
    vec *P = s->now.P;
    P[0] = two * aa + weight_0 * s_a * s_a + Q[0];
    P[1] = two * ab + weight_0 * s_a * s_b;
    P[2] = two * aw + weight_0 * s_a * s_w;
    P[3] = two * at;
    P[4] = two * al;
    P[5] = two * bb + weight_0 * s_b * s_b + Q[1];
    P[6] = two * bw + weight_0 * s_b * s_w;
    P[7] = two * bt;
    P[8] = two * bl;
    P[9] = two * ww + weight_0 * s_w * s_w + Q[2];
    P[10] = two * wt;
    P[11] = two * wl;
    P[12] = two * tt + Q[3];
    P[13] = two * tl;
    P[14] = two * ll + Q[4];
    shift[0] = s_a;
    shift[1] = s_b;
    shift[2] = s_w;
}

/* UKF, one sub-step; kappa as in paper `adhesion`. The factor is triangular: pair j moves none of the
 * states before it. */
static inline void predict_unscented(struct block *s, double dt, double kappa, int repaired)
{
    const double reach = sqrt(5.0 + kappa);
    const struct factor l = factor_or_repair(s, repaired);
    const vec zero = broadcast(0.0);
    const vec l20 = reach * l.l20, l30 = reach * l.l30, l40 = reach * l.l40;
    const vec l21 = reach * l.l21, l31 = reach * l.l31, l41 = reach * l.l41;
    const vec l22 = reach * l.l22, l32 = reach * l.l32, l42 = reach * l.l42;
    const vec l33 = reach * l.l33, l43 = reach * l.l43, l44 = reach * l.l44;
    vec sin, cos;
    sine_cosine(s->now.x[3], &sin, &cos);
    const struct points points = {
        .q = {pair_of(s, sin, cos, reach * l.l00, reach * l.l10, l20, l30, l40),
              pair_of(s, sin, cos, zero, reach * l.l11, l21, l31, l41),
              pair_of(s, sin, cos, zero, zero, l22, l32, l42),
              pair_of(s, sin, cos, zero, zero, zero, l33, l43)},
        .o_w4 = s->f * l44,
        .o_t = {l30 + dt * l20, l31 + dt * l21, l32 + dt * l22, l33},
        .o_l = {l40, l41, l42, l43, l44},
    };
    vec shift[3];
    merge_points(s, &points, kappa, shift);
    propagate(s, sin, cos, dt);
    for (int i = 0; i < 3; i++)
        s->now.x[i] += shift[i];
}

/* P <- F P F' + N, for the selected lanes. */
static void transform(vec *P, vec F[STATES][STATES], const vec *N, mask chosen)
{
    vec full[STATES][STATES], M[STATES][STATES];
    for (int i = 0, row = 0; i < STATES; i++)
        for (int j = i; j < STATES; j++, row++)
            full[i][j] = full[j][i] = P[row];
    for (int i = 0; i < STATES; i++)
        for (int j = 0; j < STATES; j++) {
            M[i][j] = broadcast(0.0);
            for (int n = 0; n < STATES; n++)
                M[i][j] += F[i][n] * full[n][j];
        }
    for (int i = 0, row = 0; i < STATES; i++)
        for (int j = i; j < STATES; j++, row++) {
            vec sum = N[row];
            for (int n = 0; n < STATES; n++)
                sum += M[i][n] * F[j][n];
            P[row] = select(chosen, sum, P[row]);
        }
}

/* Predict over missing samples: torque and acceleration stay constant for tau = gap dt, in which
 * the voltage is not known. An unknown current of variance `coast` has made torque meanwhile, which
 * is in speed and angle, and is in the currents at the end, so that the next sample sets only them.
 * Lanes without a gap do not change. */
static void predict_gap(struct block *s, vec gap, double dt)
{
    const vec tau = gap * dt, half = 0.5 * tau * tau, k = s->kappa_J;
    const vec i_a = s->now.x[0], i_b = s->now.x[1], w = s->now.x[2];
    vec sin, cos, sin_t, cos_t;
    sine_cosine(s->now.x[3], &sin, &cos);
    const vec a = k * (i_b * cos - i_a * sin) - s->p_J * s->now.x[4] - s->B_J * w;
    const vec turn = tau * w + half * a;
    sine_cosine(turn, &sin_t, &cos_t);
    const vec x[STATES] = {cos_t * i_a - sin_t * i_b, sin_t * i_a + cos_t * i_b, w + tau * a,
                           wrap(s->now.x[3] + turn), s->now.x[4]};

    const vec da[STATES] = {-k * sin, k * cos, -s->B_J, -k * (i_b * sin + i_a * cos), -s->p_J};
    vec F[STATES][STATES] = {{cos_t, -sin_t}, {sin_t, cos_t}}; /* d x / d (x before) */
    for (int j = 0; j < STATES; j++) {
        vec d_turn = half * da[j];
        if (j == 2)
            d_turn += tau;
        F[0][j] -= x[1] * d_turn;
        F[1][j] += x[0] * d_turn;
        F[2][j] = tau * da[j];
        F[3][j] = d_turn;
    }
    F[2][2] += 1.0;
    F[3][3] += 1.0;
    F[4][4] = broadcast(1.0);

    const vec g_w = k * tau, g_t = k * half;
    vec N[TRIANGLE] = {[0] = s->coast,
                       [5] = s->coast,
                       [9] = s->coast * g_w * g_w,
                       [10] = s->coast * g_w * g_t,
                       [12] = s->coast * g_t * g_t};
    const mask has_gap = gap > 0.0;
    for (int i = 0; i < STATES; i++) {
        N[VARIANCES[i]] += gap * s->Q[i];
        s->now.x[i] = select(has_gap, x[i], s->now.x[i]);
    }
    transform(s->now.P, F, N, has_gap);
}

/* K = P H' S^-1, eq. (8), where H selects the first two states; and S^-1. */
struct gain {
    vec k00, k01, k10, k11, k20, k21, k30, k31, k40, k41;
    vec i00, i01, i11;
    mask good; /* S is positive definite */
};

static inline struct gain gain_of(const vec *P, const vec *R)
{
    const vec p00 = P[0], p01 = P[1], p02 = P[2], p03 = P[3], p04 = P[4];
    const vec p11 = P[5], p12 = P[6], p13 = P[7], p14 = P[8];
    const vec s00 = p00 + R[0], s11 = p11 + R[1];
    const vec det = s00 * s11 - p01 * p01;
    const vec inv = 1.0 / det;
    const vec i00 = s11 * inv, i01 = -p01 * inv, i11 = s00 * inv;
    return (struct gain){
        .k00 = p00 * i00 + p01 * i01,
        .k01 = p00 * i01 + p01 * i11,
        .k10 = p01 * i00 + p11 * i01,
        .k11 = p01 * i01 + p11 * i11,
        .k20 = p02 * i00 + p12 * i01,
        .k21 = p02 * i01 + p12 * i11,
        .k30 = p03 * i00 + p13 * i01,
        .k31 = p03 * i01 + p13 * i11,
        .k40 = p04 * i00 + p14 * i01,
        .k41 = p04 * i01 + p14 * i11,
        .i00 = i00,
        .i01 = i01,
        .i11 = i11,
        .good = det > 0.0,
    };
}

/* P <- (I - K H) P (I - K H)' + K R K', Joseph form. */
static inline void correct_covariance(vec *P, const vec *R, const struct gain *gain)
{
    const vec k00 = gain->k00, k01 = gain->k01, k10 = gain->k10, k11 = gain->k11;
    const vec k20 = gain->k20, k21 = gain->k21, k30 = gain->k30, k31 = gain->k31;
    const vec k40 = gain->k40, k41 = gain->k41, r0 = R[0], r1 = R[1];
    const vec p00 = P[0], p01 = P[1], p02 = P[2], p03 = P[3], p04 = P[4];
    const vec p11 = P[5], p12 = P[6], p13 = P[7], p14 = P[8];

    /* W = (I - K H) P; then minus its first two columns times K', plus K R K'. */
    const vec w00 = p00 - k00 * p00 - k01 * p01, w01 = p01 - k00 * p01 - k01 * p11;
    const vec w02 = p02 - k00 * p02 - k01 * p12, w03 = p03 - k00 * p03 - k01 * p13;
    const vec w04 = p04 - k00 * p04 - k01 * p14;
    const vec w10 = p01 - k10 * p00 - k11 * p01, w11 = p11 - k10 * p01 - k11 * p11;
    const vec w12 = p12 - k10 * p02 - k11 * p12, w13 = p13 - k10 * p03 - k11 * p13;
    const vec w14 = p14 - k10 * p04 - k11 * p14;
    const vec w20 = p02 - k20 * p00 - k21 * p01, w21 = p12 - k20 * p01 - k21 * p11;
    const vec w22 = P[9] - k20 * p02 - k21 * p12, w23 = P[10] - k20 * p03 - k21 * p13;
    const vec w24 = P[11] - k20 * p04 - k21 * p14;
    const vec w30 = p03 - k30 * p00 - k31 * p01, w31 = p13 - k30 * p01 - k31 * p11;
    const vec w33 = P[12] - k30 * p03 - k31 * p13, w34 = P[13] - k30 * p04 - k31 * p14;
    const vec w40 = p04 - k40 * p00 - k41 * p01, w41 = p14 - k40 * p01 - k41 * p11;
    const vec w44 = P[14] - k40 * p04 - k41 * p14;
    const vec a00 = k00 * r0 - w00, a01 = k01 * r1 - w01, a10 = k10 * r0 - w10;
    const vec a11 = k11 * r1 - w11, a20 = k20 * r0 - w20, a21 = k21 * r1 - w21;
    const vec a30 = k30 * r0 - w30, a31 = k31 * r1 - w31, a40 = k40 * r0 - w40;
    const vec a41 = k41 * r1 - w41;
    P[0] = w00 + a00 * k00 + a01 * k01;
    P[1] = w01 + a00 * k10 + a01 * k11;
    P[2] = w02 + a00 * k20 + a01 * k21;
    P[3] = w03 + a00 * k30 + a01 * k31;
    P[4] = w04 + a00 * k40 + a01 * k41;
    P[5] = w11 + a10 * k10 + a11 * k11;
    P[6] = w12 + a10 * k20 + a11 * k21;
    P[7] = w13 + a10 * k30 + a11 * k31;
    P[8] = w14 + a10 * k40 + a11 * k41;
    P[9] = w22 + a20 * k20 + a21 * k21;
    P[10] = w23 + a20 * k30 + a21 * k31;
    P[11] = w24 + a20 * k40 + a21 * k41;
    P[12] = w33 + a30 * k30 + a31 * k31;
    P[13] = w34 + a30 * k40 + a31 * k41;
    P[14] = w44 + a40 * k40 + a41 * k41;
}

/* Update x, P by the currents y; returns lanes with a finite result and no variance below 0. */
static inline mask correct(struct block *s)
{
    vec *P = s->now.P, *x = s->now.x;
    const struct gain g = gain_of(P, s->R);
    correct_covariance(P, s->R, &g);
    const vec nu0 = s->y[0] - x[0], nu1 = s->y[1] - x[1];
    s->nis = g.i00 * nu0 * nu0 + 2.0 * g.i01 * nu0 * nu1 + g.i11 * nu1 * nu1;
    x[0] += g.k00 * nu0 + g.k01 * nu1;
    x[1] += g.k10 * nu0 + g.k11 * nu1;
    x[2] += g.k20 * nu0 + g.k21 * nu1;
    x[3] = wrap(x[3] + g.k30 * nu0 + g.k31 * nu1);
    x[4] += g.k40 * nu0 + g.k41 * nu1;

    /* A sum is NaN or infinite if a term is. */
    vec total = ((x[0] + x[1]) + (x[2] + x[3])) + x[4];
    for (int row = 0; row < TRIANGLE; row++)
        total += P[row];
    mask good = g.good & (absolute(total) <= DBL_MAX);
    for (int i = 0; i < STATES; i++) {
        vec *variance = &P[VARIANCES[i]];
        good &= *variance >= 0.0;
        *variance = at_least(*variance, FLOOR);
    }
    return good;
}

/* Copy the state of a drive, and its noise, into lane k. */
static inline void load_lane(struct block *s, int k, const struct filter_noise *noise,
                             const struct filter *filter)
{
    s->bias[k] = filter->v_q_bias;
    s->coast[k] = noise->coast;
    for (int i = 0; i < 2; i++)
        s->R[i][k] = noise->R[i] * filter->r_scale;
    for (int i = 0, row = 0; i < STATES; i++) {
        s->Q[i][k] = noise->Q[i];
        s->now.x[i][k] = filter->x[i];
        for (int j = i; j < STATES; j++)
            s->now.P[row++][k] = filter->P[i][j];
    }
}

/* The coefficients of eq. (12); L_s and J are above 0. A lane without a drive has those of the first. */
static inline void load_motors(struct block *s, const struct pmsm *motors, int drives, double dt)
{
    vec R_s = {0}, L_s = {0}, psi_f = {0}, p = {0}, J = {0}, B = {0}, k_p = {0};
    for (int k = 0; k < LANES; k++) {
        const struct pmsm *motor = &motors[k < drives ? k : 0];
        R_s[k] = motor->R_s;
        L_s[k] = motor->L_s;
        psi_f[k] = motor->psi_f;
        p[k] = motor->p;
        J[k] = motor->J;
        B[k] = motor->B;
        k_p[k] = motor->k_p;
    }
    s->kappa_J = k_p * p * p * psi_f / J;
    s->p_J = p / J;
    s->B_J = B / J;
    s->dt_L = dt / L_s;
    s->a = 1.0 - R_s * s->dt_L;
    s->b = psi_f * s->dt_L;
    s->d = 1.0 - s->B_J * dt;
    s->e = s->kappa_J * dt;
    s->f = -s->p_J * dt;
}

static inline void store_lane(const struct block *s, int k, struct filter *filter)
{
    for (int i = 0, row = 0; i < STATES; i++) {
        filter->x[i] = s->now.x[i][k];
        for (int j = i; j < STATES; j++, row++)
            filter->P[i][j] = filter->P[j][i] = s->now.P[row][k];
    }
}

/* Work of the lanes of a block in the next round. */
struct round {
    int64_t next[LANES]; /* index of the lane's next sample; -1: none */
    mask wanted;         /* the lane's sample is of this round */
    vec gap;             /* sub-steps missing before it */
    int64_t steps;       /* sub-steps of all samples of this round; 0: there are none */
    int has_gap;
};

/* Select the samples that can be processed together: those with as many sub-steps as the first. */
static inline void load_samples(struct block *s, struct round *round,
                                const struct filter_sample *samples)
{
    round->steps = 0;
    round->has_gap = 0;
    round->wanted = (mask){0};
    round->gap = broadcast(0.0);
    for (int k = 0; k < LANES; k++) {
        if (round->next[k] < 0)
            continue;
        const struct filter_sample *sample = &samples[round->next[k]];
        if (round->steps == 0)
            round->steps = sample->steps;
        if (sample->steps != round->steps)
            continue;
        round->wanted[k] = -1;
        round->gap[k] = (double)sample->gap;
        round->has_gap |= sample->gap > 0;
        s->u[0][k] = creal(sample->u);
        s->u[1][k] = cimag(sample->u);
        s->y[0][k] = creal(sample->i);
        s->y[1][k] = cimag(sample->i);
    }
}

/* Process one sample of every lane; returns the lanes whose state is good. */
static inline mask run_lanes(struct block *s, const struct round *round,
                             const struct filter_settings *settings, int repaired)
{
    const double dt = settings->dt;
    if (round->has_gap)
        predict_gap(s, round->gap, dt);
    turn_voltage(s, round->steps, dt);
    s->has_root = ~(mask){0};
    if (!settings->unscented)
        sine_cosine(s->now.x[3], &s->sin, &s->cos);
    for (int64_t j = 0; j < round->steps; j++) {
        if (settings->unscented)
            predict_unscented(s, dt, settings->kappa, repaired);
        else
            predict_extended(s, dt, j + 1 == round->steps);
    }
    return correct(s);
}

/* Copy the lanes of a round that are good and new; all others keep their state. */
static inline mask filter_round(struct block *s, const struct round *round,
                                const struct filter_settings *settings)
{
    const struct state before = s->now;
    mask good = run_lanes(s, round, settings, 0);
    if (settings->unscented && any(~s->has_root & round->wanted)) {
        s->now = before;
        good = run_lanes(s, round, settings, 1) & s->has_root;
    }
    good &= round->wanted;
    if (!any(~good))
        return good;
    for (int i = 0; i < STATES; i++)
        s->now.x[i] = select(good, s->now.x[i], before.x[i]);
    for (int row = 0; row < TRIANGLE; row++)
        s->now.P[row] = select(good, s->now.P[row], before.P[row]);
    return good;
}

/* Process all samples of up to LANES drives. */
static void filter_block(struct filter_sample *samples, const struct pmsm *motors,
                         const struct filter_noise *noise, struct filter *filters, int drives,
                         const struct filter_settings *settings)
{
    struct block s = {0};
    struct round round;
    load_motors(&s, motors, drives, settings->dt);
    for (int k = 0; k < LANES; k++) {
        const int d = k < drives ? k : 0;
        load_lane(&s, k, &noise[d], &filters[d]);
        round.next[k] = k < drives ? filters[k].first_sample : -1;
    }
    /* Every round removes a sample from a list, so the loop ends. */
    for (load_samples(&s, &round, samples); round.steps > 0; load_samples(&s, &round, samples)) {
        const mask good = filter_round(&s, &round, settings);
        for (int k = 0; k < LANES; k++) {
            if (!round.wanted[k])
                continue;
            struct filter_sample *sample = &samples[round.next[k]];
            round.next[k] = good[k] ? sample->next : -1;
            if (good[k])
                sample->nis = s.nis[k];
            else
                filters[k].is_finite = 0;
        }
    }
    for (int k = 0; k < drives; k++)
        store_lane(&s, k, &filters[k]);
}

void SIMD_NAME(struct filter_sample *samples, int m, const struct pmsm *motors,
               const struct filter_noise *noise, struct filter *filters, int n,
               const struct filter_settings *settings)
{
    for (int d = 0; d < n; d++) {
        filters[d].first_sample = -1;
        filters[d].is_finite = 1;
    }
    for (int k = m - 1; k >= 0; k--) {
        struct filter *filter = &filters[samples[k].drive];
        samples[k].nis = (double)NAN;
        samples[k].next = filter->first_sample;
        filter->first_sample = k;
    }
    for (int d = 0; d < n; d += LANES)
        filter_block(samples, &motors[d], &noise[d], &filters[d], n - d < LANES ? n - d : LANES,
                     settings);
}
