/* Steps of sensors: no motor of 850 kg warms by kelvins within seconds. Not in paper `thermal`.
 *
 * The median of the residuals over the last seconds is compared with that of the time before. If
 * they are more than `step_k` apart, the medians are compared again when the readings have settled:
 * a burst of a loose connector is over by then, a step is not. Steps add up to the sensor's offset.
 *
 * Nothing here can fail: windows are at most STEP_WINDOW_MAX long (`struct step_config`), and a trend
 * over no samples at all is NaN, as one over too few readings is. */
#include "estimators/thermal/step_detector.h"

#include <math.h>

#include "estimators/numbers.h"
#include "estimators/order_statistics.h"

enum { MEDIAN_NEEDS = 3 }; /* least number of readings */

int step_window(const struct step_config *config)
{
    return config->before + config->after + config->settled;
}

/* Median of the readings in x[first] .. x[end - 1]; NaN for fewer than MEDIAN_NEEDS. */
static double median(const double *x, int first, int end)
{
    double values[STEP_WINDOW_MAX];
    int n = 0;
    for (int k = first; k < end; k++)
        if (isfinite(x[k]))
            values[n++] = x[k];
    return n >= MEDIAN_NEEDS ? median_in_place(values, n) : NAN;
}

/* A line through the medians of the two halves of a stretch of residuals. */
struct line {
    double at;    /* sample at which it is `value` */
    double value; /* K */
    double slope; /* K per sample */
};

/* Trend of x[first] .. x[end - 1]; NaN for too few readings. */
static struct line trend(const double *x, int first, int end)
{
    const int middle = (first + end) / 2;
    const double one = median(x, first, middle);
    const double two = median(x, middle, end);
    return (struct line){
        .at = 0.5 * (middle + end - 1),
        .value = two,
        .slope = (two - one) / (0.5 * (end - first)),
    };
}

/* Jump of x after the first `before` samples, K; NaN for too few readings.
 *
 * The jump is the later readings less what was to be expected: the continued trend before, or the
 * trend after if that explains more. A winding that begins to warm by 0.1 K/s bends, it does not
 * jump. Over a gap: less the level. */
static double jump(const struct step_config *config, const double *x, double level)
{
    const int before = config->before, after = config->after;
    const double at = before + 0.5 * (after - 1);
    const struct line then = trend(x, before + after, step_window(config));
    const struct line was = trend(x, 0, before);
    const double now = then.value + then.slope * (at - then.at);
    const double near = median(x, before - after, before);
    if (!isfinite(was.value + was.slope) || !isfinite(near))
        return now - level;
    const double straight = now - (was.value + was.slope * (at - was.at));
    const double bent = now - (near + then.slope * (at - (before - 0.5 * (after + 1))));
    return fabs(straight) < fabs(bent) ? straight : bent;
}

double step_jump(const struct step_config *config, const double *x)
{
    return jump(config, x, NAN);
}

int step_is_due(const struct step_config *config, const struct step_state *state)
{
    return state->since + 1 >= config->settled;
}

void step_reset(struct step_state *state)
{
    *state = (struct step_state){.level_k = NAN, .home_k = NAN, .since = -1};
}

/* A jump less that of the others, which may explain it but makes none. */
static double less_others(double moved, double others)
{
    return moved - clamp(others, smaller(moved, 0.0), larger(moved, 0.0));
}

/* A step was seen `since` samples ago: measure it when it has settled. */
static void settle(const struct step_config *config, struct step_state *state, const double *x,
                   double others)
{
    const int due = step_is_due(config, state);
    state->since += 1;
    if (!due)
        return;
    const double moved = less_others(jump(config, x, state->level_k), others);
    if (fabs(moved) > 0.8 * config->step_k) {
        state->offset_k += moved;
        if (fabs(state->offset_k) < config->back_k)
            state->offset_k = 0.0;
    }
    if (isfinite(moved))
        state->since = -1;
    else
        state->since = config->settled; /* too few readings since: try again at the next sample */
}

/* Update the level before the last samples, and its drift while the sensor has no offset. */
static void update_level(const struct step_config *config, struct step_state *state, double now)
{
    state->unseen = isfinite(now) ? 0 : state->unseen + (state->unseen <= config->settled);
    /* Over a short gap the level is kept; over a long one anything may warm. */
    if (isfinite(now) || state->unseen > config->settled)
        state->level_k = now;
    const double level = state->level_k;
    if (state->offset_k == 0.0 && isfinite(level)) {
        const double home = isnan(state->home_k) ? level : state->home_k;
        state->home_k = home + clamp(level - home, -config->drift_k, config->drift_k);
    } else if (fabs(level - state->home_k) < config->back_k) {
        state->offset_k = 0.0; /* it was two bursts in a row, or the sensor has crept back */
    }
}

void step_add_sample(const struct step_config *config, struct step_state *state, const double *x,
                     double others)
{
    if (state->since >= 0) {
        settle(config, state, x, others);
        return;
    }
    const int size = step_window(config);
    const int recent = size - config->after;
    update_level(config, state, median(x, recent - config->before, recent));
    /* A comparison with NaN finds no step. */
    if (fabs(median(x, recent, size) - state->level_k) > config->step_k)
        state->since = 0;
}

void step_follow(const struct step_config *config, const double *x, int64_t count, double *out)
{
    double latest[STEP_WINDOW_MAX];
    const int size = step_window(config);
    struct step_state state;
    step_reset(&state);
    for (int k = 0; k < STEP_WINDOW_MAX; k++)
        latest[k] = NAN;
    for (int64_t k = 0; k < count; k++) {
        for (int i = 1; i < size; i++)
            latest[i - 1] = latest[i];
        latest[size - 1] = x[k];
        if (k >= config->before + config->after)
            step_add_sample(config, &state, latest, 0.0);
        out[k] = state.offset_k;
    }
}
