/* Prediction of one motor's interacting filters over a block: heat flow between five lumps, the
 * contributions of disturbances and of a fault, and their uncertainty.
 *
 * Nothing here can fail: loops are bounded by constants, the halvings of a step by MOST_HALVINGS, and
 * the rise of the frame, which divides, is above 0. */
#include "estimators/thermal/imm_predict.h"

#include <math.h>

#include "estimators/elementary.h"
#include "estimators/numbers.h"
#include "estimators/thermal/imm.h"

enum { L = THERMAL_LUMPS, N = IMM_STATES, SIZE = N - 2, RATE = N - 1 };
enum { TAYLOR_ORDER = 12, MOST_HALVINGS = 60 };
enum { COOLING = 2 }; /* mode whose heat grows with the frame's own rise above the air */

static const double LEAST_COOLING = 0.2; /* least share of a frame's cooling, however cold it is */

static int is_heat(int g)
{
    return 0 < g && g <= IMM_HEATS;
}

struct square_5 {
    double a[L][L];
};

static struct square_5 multiply_5(const struct square_5 *x, const struct square_5 *y)
{
    struct square_5 out;
    for (int i = 0; i < L; i++) {
        for (int j = 0; j < L; j++) {
            double sum = 0.0;
            for (int k = 0; k < L; k++)
                sum += x->a[i][k] * y->a[k][j];
            out.a[i][j] = sum;
        }
    }
    return out;
}

static struct square_5 add_5(const struct square_5 *x, const struct square_5 *y)
{
    struct square_5 out;
    for (int i = 0; i < L; i++)
        for (int j = 0; j < L; j++)
            out.a[i][j] = x->a[i][j] + y->a[i][j];
    return out;
}

static struct square_5 scale_5(double by, const struct square_5 *x)
{
    struct square_5 out;
    for (int i = 0; i < L; i++)
        for (int j = 0; j < L; j++)
            out.a[i][j] = by * x->a[i][j];
    return out;
}

static struct square_5 diagonal_5(double value)
{
    struct square_5 out = {0};
    for (int i = 0; i < L; i++)
        out.a[i][i] = value;
    return out;
}

/* Taylor series of a step that is short enough, then doubling. */
void imm_response(const double *a, double dt, double *fade, double *gain)
{
    struct square_5 rates;
    double norm = 0.0;
    for (int i = 0; i < L; i++) {
        double sum = 0.0;
        for (int j = 0; j < L; j++) {
            rates.a[i][j] = a[i * L + j];
            sum += fabs(rates.a[i][j]);
        }
        norm = sum > norm ? sum : norm;
    }
    int halvings = 0;
    for (norm *= dt; norm > 0.5 && halvings < MOST_HALVINGS; halvings++)
        norm *= 0.5;
    const double h = ldexp(dt, -halvings);
    const struct square_5 one = diagonal_5(1.0);
    struct square_5 term = diagonal_5(h), total = term;
    for (int k = 2; k < TAYLOR_ORDER; k++) {
        const struct square_5 product = multiply_5(&term, &rates);
        term = scale_5(h / k, &product);
        total = add_5(&total, &term);
    }
    struct square_5 product = multiply_5(&rates, &total);
    struct square_5 power = add_5(&one, &product);
    for (int k = 0; k < halvings; k++) {
        product = multiply_5(&power, &total);
        total = add_5(&total, &product);
        power = multiply_5(&power, &power);
    }
    for (int i = 0; i < L * L; i++) {
        fade[i] = power.a[i / L][i % L];
        gain[i] = total.a[i / L][i % L];
    }
}

void imm_prepare(const struct imm_config *config, const struct imm_surroundings *around,
                 struct imm_prediction *out)
{
    double fade[L][L];
    imm_response(&around->rates[0][0], config->block_s, &fade[0][0], &out->gain[0][0]);
    out->keep = elementary_exp(-config->block_s / config->memory_s);
    for (int i = 0; i < N * N; i++)
        out->F[i / N][i % N] = 0.0;
    const double root = sqrt(out->keep); /* a disturbance decays while it acts */
    for (int i = 0; i < L; i++) {
        for (int j = 0; j < L; j++) {
            double pushed = 0.0;
            for (int k = 0; k < L; k++)
                pushed += out->gain[i][k] * around->pushes[k][j];
            out->F[i][j] = fade[i][j];
            out->F[i][L + j] = pushed * root;
        }
        out->F[L + i][L + i] = out->keep;
    }
    out->F[SIZE][SIZE] = 1.0;
    out->F[SIZE][RATE] = config->block_s;
    out->F[RATE][RATE] = out->keep;
}

/* Effect of 1 K of mode g's heat on the lumps in a block; x: lumps before it. */
static void heat_of(const struct imm_surroundings *around, const struct imm_prediction *by, int g,
                    const double *x, double *heat)
{
    double more = 1.0;
    if (g == COOLING)
        more = 1.0 + x[THERMAL_FRAME] / around->rise_k;
    more = more > LEAST_COOLING ? more : LEAST_COOLING;
    for (int i = 0; i < L; i++) {
        heat[i] = 0.0;
        for (int k = 0; k < L && is_heat(g); k++)
            heat[i] += by->gain[i][k] * around->heats[g - 1][k];
        heat[i] *= more;
    }
}

/* Add the process noise of mode g, whose state before the block was x; heat: see `heat_of`. */
static void add_noise(const struct imm_config *config, const struct imm_prediction *by, int g,
                      const double *x, const double *heat, double P[N][N])
{
    const double fresh = 1.0 - by->keep * by->keep;
    for (int i = 0; i < L; i++) {
        P[i][i] += square(config->own_k) * config->block_s / 60.0;
        P[i][i] += square(config->unsure * (1.0 - by->F[i][i]) * x[i]);
        P[L + i][L + i] += square(config->sigma[i]) * fresh;
        /* A fault can begin anywhere in a block, and no heat is constant. */
        for (int j = 0; j < L; j++)
            P[i][j] += square(config->unsteady) * (heat[i] * x[SIZE]) * (heat[j] * x[SIZE]);
    }
    if (g == 0)
        return;
    P[SIZE][SIZE] += square(is_heat(g) ? config->walk_k : config->walk_sensor_k);
    P[SIZE][SIZE] += square(config->walk_share * x[SIZE]);
    P[RATE][RATE] += square(config->fault[g].creep_k_s) * fresh;
}

/* out = F P F' of mode g, in which `heat` is the column of the size; most of F is zero. */
static void transform(const struct imm_prediction *by, const double *heat, const double P[N][N],
                      double out[N][N])
{
    double F[N][N], half[N][N] = {{0.0}};
    for (int i = 0; i < N; i++) {
        for (int k = 0; k < N; k++) {
            F[i][k] = i < L && k == SIZE ? heat[i] : by->F[i][k];
            out[i][k] = 0.0;
            for (int j = 0; j < N && F[i][k] != 0.0; j++)
                half[i][j] += F[i][k] * P[k][j];
        }
    }
    for (int j = 0; j < N; j++)
        for (int k = 0; k < N; k++)
            for (int i = 0; i < N && F[j][k] != 0.0; i++)
                out[i][j] += half[i][k] * F[j][k];
}

void imm_predict(const struct imm_config *config, const struct imm_surroundings *around,
                 const struct imm_prediction *by, int g, const struct imm_state *before,
                 struct imm_state *after)
{
    const double *x = before->mean[g];
    double heat[L];
    heat_of(around, by, g, x, heat);
    transform(by, heat, before->cov[g], after->cov[g]);
    add_noise(config, by, g, x, heat, after->cov[g]);
    for (int i = 0; i < N; i++) {
        after->mean[g][i] = i < L ? heat[i] * x[SIZE] : 0.0;
        for (int k = 0; k < N; k++)
            after->mean[g][i] += by->F[i][k] * x[k];
    }
}
