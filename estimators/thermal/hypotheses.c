/* Discrete Bayes filter per motor, for samples hours apart, each of a motor that has settled anew.
 * It finds the fault that explains what the thermal model does not (monitor.c is for each second).
 *
 * States: no fault; a heat fault times its size; a sensor off by a size, up or down; a loose
 * connector. In place of paper `thermal`, eq. (28)-(31).
 *
 * Nothing here can fail: densities are of scales above 0, logarithms of numbers above 0, the sum of
 * the states is above 0 as the likeliest one's factor is 1 and every state can be reached, and of
 * the sizes of every kind some are faults and some are not. */
#include "estimators/thermal/hypotheses.h"

#include <math.h>

#include "estimators/elementary.h"
#include "estimators/numbers.h"
#include "estimators/thermal/peers.h"

enum { Q = THERMAL_POINTS, H = IMM_HEATS, S = HYPOTHESIS_SIZES, GROUPS = H + 2 * Q };
enum { LOOSE = 1 + GROUPS * S }; /* index of the first loose connector's state */

static const double UNSURE = 0.15; /* relative error of a signature: sizes are 1.4 apart */
static const double HELD = 0.6;    /* share of the least size that keeps a held kind a fault */
static const double HELD_LEAST_K = 1.5;
static const double MOST_SIGMA = 3.0; /* limit of a deviation that moves a baseline */
static const double LEAST = 1e-12;    /* least probability for a mean */

/* 1.0 or -1.0: sign of a group's sensor error. */
static double sign_of(int group)
{
    return (group - H) % 2 == 0 ? 1.0 : -1.0;
}

/* Kind of a group: both signs of a sensor's error are one kind. */
static int kind_of(int group)
{
    return group < H ? group : H + (group - H) / 2;
}

/* A motor that is cooler than its model has no fault; an error of a sensor has either sign. */
static int is_fault(int group, double size, double limit)
{
    return size >= limit || (group >= H && -size >= limit);
}

/* ---- Likelihoods ---- */

/* Log density of Student's t up to a constant, for unit scale. */
static double log_tail(const struct hypothesis_config *config, double x)
{
    return -0.5 * (config->tail + 1.0) * elementary_log(1.0 + x * x / config->tail);
}

/* The same around a mean that is uncertain by UNSURE of itself. */
static double log_unsure(const struct hypothesis_config *config, double x, double mean)
{
    const double scale = sqrt(1.0 + square(UNSURE * mean));
    return log_tail(config, (x - mean) / scale) - elementary_log(scale);
}

/* Effect of 1 K of a group at point q. */
static double unit_of(const double *shapes, int group, int q)
{
    if (group < H)
        return shapes[group * Q + q];
    return (group - H) / 2 == q ? sign_of(group) : 0.0;
}

/* Add the log likelihoods of all states but loose connectors, for a sample z with all points. */
static void add_whole(const struct hypothesis_config *config,
                      const struct hypothesis_spread *spread, const double *shapes, const double *z,
                      double *says)
{
    for (int c = 0; c < Q; c++) {
        double w = 0.0;
        for (int q = 0; q < Q; q++)
            w += spread->white[c][q] * z[q];
        says[0] += spread->share[c] * log_tail(config, w);
        for (int g = 0; g < GROUPS; g++) {
            double unit = 0.0;
            for (int q = 0; q < Q; q++)
                unit += spread->white[c][q] * unit_of(shapes, g, q);
            for (int s = 0; s < S; s++)
                says[1 + g * S + s] +=
                    spread->share[c] * log_unsure(config, w, unit * config->sizes_k[s]);
        }
    }
}

/* The same from the points that have a reading, each separately. */
static void add_points(const struct hypothesis_config *config,
                       const struct hypothesis_spread *spread, const double *shapes,
                       const double *z, double *says)
{
    double least = spread->share[0];
    for (int c = 1; c < Q; c++)
        least = spread->share[c] < least ? spread->share[c] : least;
    for (int q = 0; q < Q; q++) {
        if (!isfinite(z[q]))
            continue;
        const double x = z[q] / spread->sigma_k[q];
        says[0] += least * log_tail(config, x);
        for (int g = 0; g < GROUPS; g++) {
            const double unit = unit_of(shapes, g, q) / spread->sigma_k[q];
            for (int s = 0; s < S; s++)
                says[1 + g * S + s] += least * log_unsure(config, x, unit * config->sizes_k[s]);
        }
    }
}

/* Log likelihood ratio of a loose connector to a good one, for a reading that is off by z. */
static double loose_ratio(const struct hypothesis_config *config, double z, double sigma)
{
    if (!isfinite(z))
        return 0.0;
    const double good = elementary_exp(log_tail(config, z / sigma) + config->log_t) / sigma;
    const double loose =
        (1.0 - config->loose_share) * good + config->loose_share / (2.0 * config->loose_k);
    return elementary_log(loose) - elementary_log(larger(good, 1e-300));
}

/* The same for point q relative to what the other two predict. */
static double loose_of_whole(const struct hypothesis_config *config,
                             const struct hypothesis_spread *spread, const double *z, int q)
{
    double total = 0.0, precision = 0.0;
    for (int c = 0; c < Q; c++) {
        double w = 0.0;
        for (int p = 0; p < Q; p++)
            w += spread->white[c][p] * z[p];
        total += spread->white[c][q] * w;
        precision += square(spread->white[c][q]);
    }
    return loose_ratio(config, total / precision, 1.0 / sqrt(precision));
}

/* Log likelihoods of all states. */
static void likelihoods(const struct hypothesis_config *config,
                        const struct hypothesis_spread *spread, const double *shapes,
                        const double *z, double *says)
{
    const int whole = isfinite(z[0]) && isfinite(z[1]) && isfinite(z[2]);
    for (int n = 0; n < LOOSE; n++)
        says[n] = 0.0;
    if (whole)
        add_whole(config, spread, shapes, z, says);
    else
        add_points(config, spread, shapes, z, says);
    for (int q = 0; q < Q; q++)
        says[LOOSE + q] = says[0] + (whole ? loose_of_whole(config, spread, z, q)
                                           : loose_ratio(config, z[q], spread->sigma_k[q]));
}

/* ---- Markov chain and Bayes ---- */

/* Sizes of one group after a step of the chain; p, out (S). */
static void move_group(const struct hypothesis_config *config, int group, double nothing,
                       const double *p, double *out)
{
    const double limit = config->benign_k[kind_of(group)];
    int faults = 0;
    for (int s = 0; s < S; s++)
        faults += is_fault(group, config->sizes_k[s], limit);
    const double share = nothing / (H + Q) * (group < H ? 1.0 : 0.5);
    for (int s = 0; s < S; s++) {
        double moved = p[s] * (1.0 - 2.0 * config->growth);
        moved += config->growth * p[s > 0 ? s - 1 : s];
        moved += config->growth * p[s + 1 < S ? s + 1 : s];
        const double enter = is_fault(group, config->sizes_k[s], limit)
                                 ? config->begin / faults
                                 : config->often / (S - faults);
        out[s] = (1.0 - config->end) * moved + share * enter;
    }
}

/* One step of the chain; p: probabilities before; out: after. */
static void move(const struct hypothesis_config *config, const double *p, double *out)
{
    out[0] = p[0] * (1.0 - config->begin - config->often) + (1.0 - p[0]) * config->end;
    for (int g = 0; g < GROUPS; g++)
        move_group(config, g, p[0], &p[1 + g * S], &out[1 + g * S]);
    for (int q = 0; q < Q; q++) {
        /* Between two bursts no fault is visible: this state must not last. */
        const double was = p[LOOSE + q];
        out[LOOSE + q] = (1.0 - config->loose_end) * was + p[0] * config->begin / (H + Q);
        out[0] += (config->loose_end - config->end) * was;
    }
}

static void bayes(const double *moved, const double *says, double *p)
{
    double best = says[0], total = 0.0;
    for (int n = 1; n < HYPOTHESIS_STATES; n++)
        best = larger(says[n], best);
    for (int n = 0; n < HYPOTHESIS_STATES; n++) {
        p[n] = moved[n] * elementary_exp(says[n] - best);
        total += p[n];
    }
    for (int n = 0; n < HYPOTHESIS_STATES; n++)
        p[n] /= total;
}

/* ---- Results ---- */

/* Probabilities of the kinds. For a kind that is held for a fault, smaller sizes count as well. */
static void sum_kinds(const struct hypothesis_config *config, struct hypothesis_state *state)
{
    for (int c = 0; c < THERMAL_KINDS; c++)
        state->kind[c] = c < H + Q ? 0.0 : state->p[LOOSE + c - (H + Q)];
    for (int g = 0; g < GROUPS; g++) {
        const int c = kind_of(g);
        double limit = config->benign_k[c];
        if (c == state->held)
            limit = larger(HELD * limit, HELD_LEAST_K);
        for (int s = 0; s < S; s++)
            if (is_fault(g, config->sizes_k[s], limit))
                state->kind[c] += state->p[1 + g * S + s];
    }
}

static void mean_sizes(const struct hypothesis_config *config, struct hypothesis_state *state)
{
    double weight = 0.0, total = 0.0, sensors = 0.0, rise = 0.0;
    for (int g = 0; g < GROUPS; g++) {
        for (int s = 0; s < S; s++) {
            const double p = state->p[1 + g * S + s], size = config->sizes_k[s];
            weight += p;
            total += p * (g < H ? size : fabs(size));
            sensors += g < H ? 0.0 : p;
            rise += g < H ? 0.0 : p * sign_of(g) * size;
        }
    }
    state->size_k = weight > LEAST ? total / weight : 0.0;
    state->rise_k = sensors > LEAST ? rise / sensors : 0.0;
}

/* Decide what is held and trusted, and update the baseline; off (Q): K relative to the peers. */
static void conclude(const struct hypothesis_config *config, const struct hypothesis_spread *spread,
                     const double *off, struct hypothesis_state *state)
{
    int likeliest = 0;
    double any = 0.0, lasting = 0.0;
    for (int c = 0; c < THERMAL_KINDS; c++) {
        likeliest = state->kind[c] > state->kind[likeliest] ? c : likeliest;
        any += state->kind[c];
        lasting += c < H + Q ? state->kind[c] : 0.0;
    }
    state->held = state->kind[likeliest] > 0.5 ? likeliest : -1;
    state->trusted = 1.0 - any > 0.5;
    /* Between its bursts a loose connector reads like a good one. If the baseline were not learnt
     * then, wear and dirt would pass for heat afterwards. */
    const double rate = config->learn * (1.0 - lasting);
    for (int q = 0; q < Q; q++) {
        const double most = MOST_SIGMA * spread->sigma_k[q];
        if (isfinite(off[q]))
            state->base_k[q] += rate * clamp(off[q], -most, most);
    }
}

void hypothesis_start(struct hypothesis_state *state)
{
    *state = (struct hypothesis_state){.p = {1.0}, .held = -1, .trusted = 1};
}

void hypothesis_step(const struct hypothesis_config *config, const struct hypothesis_spread *spread,
                     struct hypothesis_state *state, int motors, const double *z,
                     const double *shapes, double *workspace)
{
    const int64_t cells = (int64_t)motors * Q;
    double *u = workspace, *beside = u + cells, *sorted = beside + cells;
    uint8_t *trusted = (uint8_t *)(sorted + motors);
    double moved[HYPOTHESIS_STATES], says[HYPOTHESIS_STATES] = {0};
    for (int m = 0; m < motors; m++)
        trusted[m] = state[m].trusted != 0;
    for (int64_t c = 0; c < cells; c++)
        u[c] = z[c] - state[c / Q].base_k[c % Q];
    peers_median(u, trusted, motors, sorted, beside);
    for (int m = 0; m < motors; m++) {
        double off[Q];
        for (int q = 0; q < Q; q++)
            off[q] = u[m * Q + q] - beside[m * Q + q];
        move(config, state[m].p, moved);
        likelihoods(config, &spread[m], shapes, off, says);
        bayes(moved, says, state[m].p);
        sum_kinds(config, &state[m]);
        mean_sizes(config, &state[m]);
        conclude(config, &spread[m], off, &state[m]);
    }
}

/* ---- heat or a sensor */

static double sum_of(const double *kind, int first, int last)
{
    double total = 0.0;
    for (int c = first; c < last; c++)
        total += kind[c];
    return total;
}

int thermal_side(const double *kind, double named)
{
    const double hot = sum_of(kind, 0, H);
    const double off = sum_of(kind, H, H + Q);
    const double loose = sum_of(kind, H + Q, THERMAL_KINDS);
    const double share = hot / larger(hot + off, 1e-300);
    if (loose > hot + off)
        return -1;
    if (share >= named)
        return 1;
    return share <= 1.0 - named ? -1 : 0;
}

void thermal_sides(const double *kind, int64_t rows, double named, int64_t *side)
{
    for (int64_t k = 0; k < rows; k++)
        side[k] = thermal_side(kind + k * THERMAL_KINDS, named);
}
