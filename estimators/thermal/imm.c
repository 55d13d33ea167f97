/* Interacting multiple models (Blom and Bar-Shalom 1988): which fault, if any, explains what the
 * thermal model does not.
 *
 * One Kalman filter per explanation, of which one is true at a time: only disturbances, which every
 * motor has; a heat fault, whose size is a state; a sensor that is off. State vector x: deviations
 * of five lumps, K; five disturbances; the fault's size, K; its creep rate, K/s, which only a
 * sensor fault has. In place of paper `thermal`, eq. (28)-(31): a filter without the faults among
 * its explanations follows a fault.
 *
 * Nothing here can fail: divisors are probabilities above 0, as every mode keeps LEAST and no
 * fault begins or ends with certainty; roots and logarithms are of numbers bounded from
 * below. */
#include "estimators/thermal/imm.h"

#include <math.h>

#include "estimators/elementary.h"
#include "estimators/numbers.h"
#include "estimators/thermal/imm_predict.h"
#include "estimators/thermal/imm_update.h"
#include "estimators/thermal/model.h"

enum { L = THERMAL_LUMPS, N = IMM_STATES, SIZE = N - 2, RATE = N - 1 };
enum { RESISTANCE = IMM_HEATS }; /* mode whose heat follows the squared current */

/* K, first standard deviations of the lumps: core and frame have no sensor. */
static const double FIRST_K[L] = {0.3, 5.0, 2.0, 0.3, 0.3};

/* Heat faults that one sensor alone may show: overheating, bearings. */
static const int LOCAL_HEAT[THERMAL_POINTS] = {0, 2, 3};

static const double SPREAD = 0.5; /* share of the largest deviation that is heat as well */

static const double LEAST = 1e-30;         /* least probability of a mode */
static const double LEAST_SHARE = 1e-12;   /* smaller shares of a mixture are skipped */
static const double LEAST_VARIANCE = 1e-9; /* least variance of a size, K^2 */

static int is_heat(int g)
{
    return 0 < g && g <= IMM_HEATS;
}

/* ---- Start and mixing ---- */

void imm_start(const struct imm_config *config, struct imm_state *state)
{
    *state = (struct imm_state){0};
    for (int g = 0; g < IMM_MODES; g++) {
        const struct imm_fault *fault = &config->fault[g];
        state->mode[g] = g == 0 ? 1.0 : LEAST;
        for (int i = 0; i < L; i++) {
            state->cov[g][i][i] = square(FIRST_K[i]);
            state->cov[g][L + i][L + i] = square(config->sigma[i]);
        }
        state->mean[g][SIZE] = fault->mean_k;
        state->cov[g][SIZE][SIZE] = square(fault->sigma_k);
        state->cov[g][RATE][RATE] = square(fault->creep_k_s);
    }
}

/* Mode 0 after the chain: the motor stays healthy, or becomes so and loses its size. */
static void mix_healthy(const struct imm_state *from, int modes, const double *share,
                        struct imm_state *to)
{
    double *mean = to->mean[0];
    for (int i = 0; i < N; i++) {
        mean[i] = 0.0;
        for (int j = 0; j < N; j++)
            to->cov[0][i][j] = 0.0;
    }
    for (int g = 0; g < modes; g++)
        for (int i = 0; i < SIZE; i++)
            mean[i] += share[g] * from->mean[g][i];
    for (int g = 0; g < modes; g++) {
        if (share[g] <= LEAST_SHARE)
            continue;
        for (int i = 0; i < SIZE; i++)
            for (int j = 0; j < SIZE; j++)
                to->cov[0][i][j] +=
                    share[g] * (from->cov[g][i][j] +
                                (from->mean[g][i] - mean[i]) * (from->mean[g][j] - mean[j]));
    }
}

/* Mode g after the chain: the fault continues, or has just begun, with the share `fresh`. */
static void mix_fault(const struct imm_config *config, const struct imm_state *from, int g,
                      double fresh, struct imm_state *to)
{
    const struct imm_fault *fault = &config->fault[g];
    double a[N], b[N];
    for (int i = 0; i < N; i++) {
        const double begun = i == SIZE ? fault->mean_k : i == RATE ? 0.0 : from->mean[0][i];
        to->mean[g][i] = fresh * begun + (1.0 - fresh) * from->mean[g][i];
        a[i] = begun - to->mean[g][i];
        b[i] = from->mean[g][i] - to->mean[g][i];
    }
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < N; j++) {
            double sum = fresh * a[i] * a[j] + (1.0 - fresh) * (from->cov[g][i][j] + b[i] * b[j]);
            if (i < SIZE && j < SIZE)
                sum += fresh * from->cov[0][i][j];
            to->cov[g][i][j] = sum;
        }
    }
    to->cov[g][SIZE][SIZE] += fresh * square(fault->sigma_k);
    to->cov[g][RATE][RATE] += fresh * square(fault->creep_k_s);
}

void imm_mix(const struct imm_config *config, const struct imm_state *from, int modes, double begin,
             double end, struct imm_state *to)
{
    double share[IMM_MODES] = {0}, ended = 0.0;
    for (int g = 1; g < modes; g++)
        ended += from->mode[g];
    to->mode[0] = (1.0 - begin) * from->mode[0] + end * ended;
    for (int g = 0; g < modes; g++)
        share[g] = (g == 0 ? 1.0 - begin : end) * from->mode[g] / to->mode[0];
    mix_healthy(from, modes, share, to);
    for (int g = 1; g < modes; g++) {
        const double entering = begin * from->mode[0] * config->fault[g].share;
        to->mode[g] = (1.0 - end) * from->mode[g] + entering;
        mix_fault(config, from, g, entering / to->mode[g], to);
    }
}

/* ---- One block, and its result ---- */

/* Probability that a normal number with this mean and variance is above the limit. */
static double above(double limit, double mean, double variance)
{
    return 0.5 * elementary_erfc((limit - mean) / sqrt(2.0 * larger(variance, LEAST_VARIANCE)));
}

/* Log probability that the size of a mode is above 0. */
static double log_warmer(const struct imm_state *state, int g)
{
    const double p = above(0.0, state->mean[g][SIZE], state->cov[g][SIZE][SIZE]);
    return elementary_log(larger(p, LEAST));
}

/* Advance mode g by a block; returns its log likelihood. */
static double advance_mode(const struct imm_config *config, const struct imm_surroundings *around,
                           const struct imm_prediction *by, int g, const struct imm_state *mixed,
                           const double *y, double noise, struct imm_state *state)
{
    imm_predict(config, around, by, g, mixed, state);
    const double before = is_heat(g) ? log_warmer(state, g) : 0.0;
    const double says =
        imm_update(g, y, noise, config->wide_k, state->mean[g], &state->cov[g][0][0]);
    /* No fault cools: of a normal size, only the part above 0 is an explanation. */
    return is_heat(g) ? says + log_warmer(state, g) - before : says;
}

double imm_advance(const struct imm_config *config, const struct imm_surroundings *around,
                   const double *y, double noise, int held, struct imm_state *state)
{
    const int modes = config->modes < IMM_MODES ? config->modes : IMM_MODES;
    struct imm_state mixed;
    struct imm_prediction by;
    /* While a fault is reported no other begins: a new one would replace an explanation that is
     * less likely as yet, and the actual fault would be lost. */
    const double begin = held || modes == 1 ? 0.0 : config->begin_per_s * config->block_s;
    imm_mix(config, state, modes, begin, config->end_per_s * config->block_s, &mixed);
    imm_prepare(config, around, &by);
    double says[IMM_MODES], top = 0.0, total = 0.0;
    for (int g = 0; g < modes; g++) {
        says[g] = advance_mode(config, around, &by, g, &mixed, y, noise, state);
        top = g == 0 || says[g] > top ? says[g] : top;
    }
    for (int g = 0; g < modes; g++) {
        state->mode[g] = larger(mixed.mode[g] * elementary_exp(says[g] - top), LEAST);
        total += state->mode[g];
    }
    for (int g = 0; g < modes; g++)
        state->mode[g] /= total;
    return top + elementary_log(total);
}

/* Probability that the reading that shows most is warmer by `shown_k`. */
static double shows(const struct imm_config *config, const struct imm_state *state, int g)
{
    double most = 0.0;
    for (int q = 0; q < THERMAL_POINTS; q++) {
        const int i = THERMAL_SEEN[q];
        const double here = above(config->shown_k, state->mean[g][i], state->cov[g][i][i]);
        most = here > most ? here : most;
    }
    return most;
}

/* Point at which mode g has warmed the motor most. */
static int warmest(const struct imm_state *state, int g)
{
    int most = 0;
    for (int q = 1; q < THERMAL_POINTS; q++)
        if (state->mean[g][THERMAL_SEEN[q]] > state->mean[g][THERMAL_SEEN[most]])
            most = q;
    return most;
}

/* 1 if an error of one sensor would explain what mode g does: no second reading shows the heat, and
 * it does not follow the load, as that of a winding's resistance does. */
static int may_be_sensor(const struct imm_config *config, const struct imm_state *state, int g)
{
    double most = 0.0;
    int warm = 0;
    for (int p = 0; p < THERMAL_POINTS; p++)
        most = larger(most, fabs(state->mean[g][THERMAL_SEEN[p]]));
    for (int p = 0; p < THERMAL_POINTS; p++)
        warm += state->mean[g][THERMAL_SEEN[p]] >= larger(SPREAD * most, config->shown_k);
    return warm < 2 && g != RESISTANCE;
}

double imm_kinds(const struct imm_config *config, const struct imm_state *state, double *kind)
{
    double total = 0.0, sum = 0.0;
    for (int c = 0; c < IMM_MODES - 1; c++)
        kind[c] = 0.0;
    for (int g = 1; g < IMM_MODES; g++) {
        const double size = state->mean[g][SIZE], variance = state->cov[g][SIZE][SIZE];
        const double limit = config->benign_k[g - 1];
        double here = above(limit, size, variance), ambiguous = 0.0;
        if (is_heat(g)) {
            const double shown = shows(config, state, g);
            here = here < shown ? here : shown;
            ambiguous = may_be_sensor(config, state, g) ? config->ambiguous * here : 0.0;
            kind[IMM_HEATS + warmest(state, g)] += state->mode[g] * ambiguous;
        } else {
            const double low = above(limit, -size, variance);
            /* It may be heat: here or, if the sensor reads low, of another motor. */
            ambiguous = config->ambiguous * here + config->ambiguous_low * low;
            here += low;
            kind[LOCAL_HEAT[g - 1 - IMM_HEATS]] += state->mode[g] * ambiguous;
        }
        kind[g - 1] += state->mode[g] * (here - ambiguous);
        total += state->mode[g] * here;
        sum += state->mode[g] * here * fabs(size);
    }
    return total > LEAST_SHARE ? sum / total : 0.0;
}
