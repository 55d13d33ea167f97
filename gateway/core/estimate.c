/* Estimates by the filters, one tick: every station that learns from the samples, then the estimate
 * of each drive, and the start and the end of filters.
 *
 *  - A filter starts if the flux chords know speed and angle from the very last samples.
 *  - It is dropped if samples are missing for longer than it can predict, if it would become
 *    not finite, if the chords have contradicted it for DISAGREE_TICKS, and if the chords have
 *    started anew, because only they can check it. Then the chords acquire the rotor again.
 *
 * Nothing here can fail: pole pairs and fluxes are configured, above 0; a speed that is a divisor
 * is not 0; roots are taken of the variance of a filter that is finite, which is not negative
 * (filter.h). Comparisons with NaN are false, and each is written so that false is the safe answer.
 */
#include "gateway/core/estimate.h"

#include <math.h>
#include <stddef.h>

#include "estimators/acquisition.h"
#include "estimators/adaptation.h"
#include "estimators/current_calibration.h"
#include "estimators/filter.h"
#include "estimators/numbers.h"
#include "estimators/vectors.h"
#include "gateway/core/times.h"

#define W_E 2 /* of the states of a filter */
#define T_L 4
/* Sub-steps (8 ms) without samples that a filter predicts: meanwhile the voltage may turn
 * the rotor by some tenths of a radian. One missing sample is always predicted. */
#define LONGEST_GAP    64
#define DISAGREE_TICKS 3 /* consecutive ticks with contradicting chords: the filter has diverged */
#define DIVERGED_NS    100000000 /* least time for which a divergence is reported */
/* A load is no evidence while its standard deviation is this multiple of its best value, which
 * rises by SIGMA_RISE per tick: sensors may become noisier permanently. */
#define SIGMA_LIMIT 2.0
#define SIGMA_RISE  1.01
#define MOVING      0.07 /* share of rated torque per tick: more than the noise of a steady load */
/* The error of a load is found from its change per tick: the medians of an error and of the
 * difference of two errors have this ratio. P allows for a slipping wheel: 4 times too wide. */
#define CHANGE_OF_ERROR 0.954 /* median of |a - b|, a and b standard normal */
#define SPREAD_STEP     0.03
#define SPREAD_FIRST    0.5 /* divided by the number of ticks: faster at the start, for */
#define SPREAD_SLOW     100 /* at most so many ticks */
#define SPREAD_LEAST    0.01
#define SPREAD_MOST     4.0
#define LOAD_SURE       0.005 /* share of the load that a lasting error may have unseen */
/* A flux deviation of the chords is used beyond FLUX_SURE of the flux, and beyond what an error of
 * RESISTANCE_SURE in R_s would make of it. */
#define FLUX_TAU_S      0.5
#define FLUX_SURE       0.03
#define RESISTANCE_SURE 0.25

void estimator_reset(struct estimator *e)
{
    for (int k = 0; k < e->n; k++) {
        e->filters[k] = (struct filter){.nis = 2.0, .r_scale = 1.0, .is_finite = 1};
        filter_reset(&e->filters[k]);
        acquisition_restart(&e->chords[k]);
        e->sensors[k] = (struct current_calibration){.turns = 0};
        e->tracks[k] =
            (struct filter_track){.diverged_ns = -1, .best_sigma_nm = HUGE_VAL, .spread = 1.0};
    }
}

/* ---- Filters of a tick ---- */

/* Drop a filter and everything that it has learnt. */
static void drop(struct filter *filter)
{
    filter_reset(filter);
    filter->v_q_bias = 0.0;
}

static void restart(struct estimator *e, int k, struct drive_estimate *estimate)
{
    filter_reset(&e->filters[k]);
    acquisition_restart(&e->chords[k]);
    e->sensors[k] = (struct current_calibration){.turns = 0};
    e->tracks[k].flux_unsure = 0.0;
    estimate->flux_ratio = NAN;
}

/* Convert the samples of the tick to those of the filters. Filters that cannot predict the missing
 * samples start anew. Returns the number of samples. */
static int load_samples(struct estimator *e, const struct receiver *r)
{
    const int m = (int)r->tick.samples; /* 8 for each frame of a tick at most */
    for (int k = 0; k < m; k++) {
        struct filter_sample *s = &e->samples[k];
        const double *u = &r->sample_u[2 * (ptrdiff_t)k], *y = &r->sample_y[2 * (ptrdiff_t)k];
        s->drive = r->sample_drive[k];
        s->steps = r->sample_steps[k];
        s->gap = r->sample_gap[k];
        s->u = vector_of(u[0], u[1]);
        s->i = vector_of(y[0], y[1]);
        const int64_t longest = s->steps > LONGEST_GAP ? s->steps : LONGEST_GAP;
        if (s->gap > longest)
            filter_reset(&e->filters[s->drive]);
    }
    return m;
}

/* Run everything that learns from the samples. */
static void run_samples(struct estimator *e, int m)
{
    const double dt = e->settings.dt;
    calibrate_currents(e->samples, m, e->sensors, e->chords, e->rated_a, dt);
    acquisition_add(e->samples, m, e->motors, e->chords, &e->limits, dt);
    filter_run(e->samples, m, e->motors, e->noise, e->filters, e->n, &e->settings);
    adapt_filters(e->samples, m, e->filters, e->chords, e->motors, e->rated_a, dt);
}

/* Drop filters that would have become not finite. */
static void drop_not_finite(struct estimator *e)
{
    for (int k = 0; k < e->n; k++) {
        struct filter *filter = &e->filters[k];
        if (filter->is_finite)
            continue;
        const int active = filter->active;
        drop(filter);
        filter->steps = active ? -1 : 0; /* -1: a divergence, reported from this tick on */
    }
}

/* ---- What is remembered beside the filters ---- */

/* Learn the error of a settled load from its last change: the median, in small steps. */
static void learn_spread(struct filter_track *t, const struct filter *filter)
{
    if (!filter->active || filter->steps < FILTER_SETTLE_STEPS)
        return;
    const double step = larger(SPREAD_STEP, SPREAD_FIRST / (2.0 + (double)t->spread_ticks));
    const double middle = CHANGE_OF_ERROR * t->spread * sqrt(filter->P[T_L][T_L]);
    const double factor = t->load_change_nm > middle ? 1.0 + step : 1.0 / (1.0 + step);
    t->spread = clamp(t->spread * factor, SPREAD_LEAST, SPREAD_MOST);
    t->spread_ticks += t->spread_ticks < SPREAD_SLOW;
}

/* Note how much the load of every drive with samples in this tick has changed. */
static void note_changes(struct estimator *e, int m)
{
    for (int k = 0; k < e->n; k++)
        e->tracks[k].silent = 1;
    for (int k = 0; k < m; k++)
        e->tracks[e->samples[k].drive].silent = 0;
    for (int k = 0; k < e->n; k++) {
        struct filter_track *t = &e->tracks[k];
        if (t->silent)
            continue;
        t->load_change_nm = fabs(e->filters[k].x[T_L] - t->load_nm);
        t->load_nm = e->filters[k].x[T_L];
        learn_spread(t, &e->filters[k]);
    }
}

/* Learn the flux of the magnets over that of the data sheet, from the length of the chords. Errors
 * of R_s lengthen a chord, too: what they can explain is not attributed to the flux. Chords work at
 * speeds at which filters do not, and what they have learnt survives a new start. */
static void learn_flux(struct estimator *e, int k, double *flux_ratio)
{
    const struct acquisition *a = &e->chords[k];
    const struct pmsm *motor = &e->motors[k];
    if (!a->ready || !isfinite(a->psi) || a->w == 0.0)
        return;
    const double by_resistance = RESISTANCE_SURE * motor->R_s * length_of(a->i_last) / fabs(a->w);
    const double sure = FLUX_SURE * motor->psi_f + by_resistance;
    const double off = a->psi - motor->psi_f;
    const double beyond = copysign(larger(0.0, fabs(off) - sure), off) / motor->psi_f;
    const double within = smaller(fabs(off), sure) / motor->psi_f;
    const double before = isnan(*flux_ratio) ? beyond : *flux_ratio - 1.0;
    const double share = e->tick_s / FLUX_TAU_S;
    *flux_ratio = 1.0 + before + share * (beyond - before);
    e->tracks[k].flux_unsure += share * (within - e->tracks[k].flux_unsure);
}

/* ---- What is known of a drive ---- */

/* Drop a filter that the chords contradict, and note a divergence. */
static void supervise(struct estimator *e, int k, int consistency, int64_t now_ns)
{
    struct filter *filter = &e->filters[k];
    struct filter_track *t = &e->tracks[k];
    const int64_t steps = filter->steps; /* before it is dropped */
    if (steps < 0) {
        filter->steps = 0;
        t->diverged_ns = now_ns;
    }
    if (consistency != INCONSISTENT || !filter->active) {
        t->disagree_ticks = 0;
    } else if (++t->disagree_ticks >= DISAGREE_TICKS) {
        drop(filter);
        t->disagree_ticks = 0;
        /* A start that does not settle is repeated; a rotor lost after that is a divergence. */
        if (steps >= FILTER_SETTLE_STEPS)
            t->diverged_ns = now_ns;
    }
}

/* Start a filter from the chords, which know speed and angle from the very last samples. */
static void start(struct estimator *e, int k)
{
    const struct acquisition *a = &e->chords[k];
    struct filter *filter = &e->filters[k];
    acquisition_start_filter(a, &e->motors[k], e->noise[k].R, e->rated_nm[k], filter);
    filter->active = 1;
    filter->steps = 0;
    filter->nis = 2.0;
    e->tracks[k].diverged_ns = -1;
    e->tracks[k].spread = 1.0;
    e->tracks[k].spread_ticks = 0;
    if (filter->v_q_bias == 0.0)
        filter->v_q_bias = first_q_bias(a, &e->motors[k], e->rated_a[k]);
}

/* Fill in the numbers of an active filter. Returns sigma of its load by P, at data sheet flux. */
static double fill_numbers(const struct estimator *e, int k, struct drive_estimate *out)
{
    const struct filter *filter = &e->filters[k];
    const double sigma = sqrt(filter->P[T_L][T_L]);
    const double flux = isnan(out->flux_ratio) ? 1.0 : out->flux_ratio;
    out->speed_rad_s = filter->x[W_E] / e->motors[k].p;
    out->load_nm = filter->x[T_L] * flux;
    const struct filter_track *t = &e->tracks[k];
    const double scatter = t->spread * sigma;
    const double lasting = (LOAD_SURE + t->flux_unsure) * filter->x[T_L];
    out->load_sigma_nm = sqrt(square(scatter) + square(lasting)) * flux;
    out->nis = filter->nis;
    return sigma;
}

/* enum filter_health of a drive; fills in its numbers if a filter is active. */
static uint8_t describe(struct estimator *e, int k, const struct input_status *input,
                        int consistency, struct drive_estimate *out)
{
    struct filter_track *t = &e->tracks[k];
    switch (input->reason) {
    case REASON_CORRUPTED:
    case REASON_SEQUENCE:
    case REASON_RANGE:
    case REASON_NOT_AVAILABLE:
        return HEALTH_INPUT_INVALID;
    default:
        break;
    }
    /* While the load changes, that of the tick before is not used. */
    const int moving = t->silent && t->load_change_nm > MOVING * e->rated_nm[k];
    const int fresh = input->sample_fresh && !moving;
    if (!e->filters[k].active)
        return fresh ? HEALTH_CONVERGING : HEALTH_UNKNOWN;
    const double sigma = fill_numbers(e, k, out);
    if (!fresh)
        return HEALTH_PREDICTING;
    if (e->filters[k].steps < FILTER_SETTLE_STEPS || consistency != CONSISTENT)
        return HEALTH_CONVERGING;
    t->best_sigma_nm = smaller(sigma, SIGMA_RISE * t->best_sigma_nm);
    return sigma > SIGMA_LIMIT * t->best_sigma_nm ? HEALTH_CONVERGING : HEALTH_TRACKING;
}

/* Estimate of one drive; its filter starts here. */
static void estimate(struct estimator *e, int k, const struct input_status *input,
                     struct drive_estimate *out, int64_t now_ns)
{
    const struct acquisition *a = &e->chords[k];
    struct filter *filter = &e->filters[k];
    if (filter->active && a->pairs < ACQUISITION_PAIRS)
        filter_reset(filter); /* the chords have started anew, and only they can check it */
    int consistency = acquisition_check(a, filter);
    supervise(e, k, consistency, now_ns);
    out->speed_rad_s = out->load_nm = out->load_sigma_nm = out->nis = NAN;
    const int64_t diverged_ns = e->tracks[k].diverged_ns;
    if (diverged_ns >= 0 && elapsed(diverged_ns, now_ns) < DIVERGED_NS) {
        out->health = HEALTH_DIVERGED;
        return;
    }
    const int seen = a->ready && a->age < 2.0 * a->span;
    if (input->sample_fresh && seen && !filter->active) {
        start(e, k);
        consistency = CONSISTENT;
    }
    out->health = describe(e, k, input, consistency, out);
}

void run_filters(struct estimator *e, const struct receiver *receiver,
                 const struct input_status *inputs, struct drive_estimate *estimates,
                 int64_t now_ns)
{
    for (int k = 0; k < e->n; k++)
        if (receiver->drives[k].restart)
            restart(e, k, &estimates[k]);
    const int m = load_samples(e, receiver);
    run_samples(e, m);
    drop_not_finite(e);
    note_changes(e, m);
    for (int k = 0; k < e->n; k++) {
        learn_flux(e, k, &estimates[k].flux_ratio);
        estimate(e, k, &inputs[k], &estimates[k], now_ns);
    }
}
