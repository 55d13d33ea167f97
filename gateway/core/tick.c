/* One period: the order of everything that happens in it, and nothing else.
 *
 * A live tick, a replay of a log and a simulation all use this: `run` with one tick or with many.
 * Nothing here can fail: every station bounds its own numbers and indices, and `run` checks for
 * room before a tick begins. */
#include "gateway/core/tick.h"

#include <math.h>

#include "gateway/core/adhesion.h"
#include "gateway/core/busload.h"
#include "gateway/core/creep.h"
#include "gateway/core/estimate.h"
#include "gateway/core/flags.h"
#include "gateway/core/inputs.h"
#include "gateway/core/integrity.h"
#include "gateway/core/motion.h"
#include "gateway/core/receive.h"
#include "gateway/core/supervision.h"
#include "gateway/core/thermal.h"
#include "gateway/core/tick_log.h"
#include "gateway/core/transmit.h"

/* Frames of one tick: `count` rows from `first`. */
struct frame_range {
    int64_t first, count;
};

/* Receive the frames of a tick. Returns 1; or 0, with nothing done, for frames in another order. */
static int receive(struct gateway *g, const struct frame_columns *all, struct frame_range rows,
                   int64_t now_ns)
{
    if (!receive_frames(g->receiver, all, rows.first, rows.count, now_ns))
        return 0;
    check_integrity(g->integrity, g->receiver->tick.own, now_ns);
    if (!g->is_translated) {
        bus_load_tick(g->load, now_ns);
        bus_load_receive(g->load, g->receiver, all, rows.first, rows.count);
    }
    return 1;
}

static void check_heartbeats(struct gateway *g, int64_t now_ns)
{
    for (int32_t k = 0; k < g->drive_count; k++)
        g->inputs[k].heartbeat_lost = (uint8_t)is_node_lost(g->receiver->supervision, k, now_ns);
}

/* Copy the results of the stations to where evidence is collected from. */
static void gather(struct gateway *g)
{
    const struct adhesion *adhesion = g->adhesion;
    for (int32_t k = 0; k < g->drive_count; k++) {
        const struct input_status *in = &g->inputs[k];
        const struct drive_estimate *estimate = &g->estimates[k];
        struct flag_inputs *out = &g->flag_inputs[k];
        out->input_reason = in->reason;
        out->comm = in->comm;
        out->current_sum_fault = in->current_sum_fault;
        out->input_implausible = g->motion->motions[k].implausible;
        out->sample_ns = g->receiver->drives[k].sample_ns;
        out->health = estimate->health;
        out->health_reason = estimate->health_reason;
        out->speed_rad_s = estimate->speed_rad_s;
        out->nis = estimate->nis;
        out->load_nm = estimate->load_nm;
        out->load_sigma_nm = estimate->load_sigma_nm;
        out->loss_probability = adhesion->loss_probability[k];
        out->loss_known = adhesion->loss_known[k];
        out->withdrawn = adhesion->rotor_inputs[k].withdrawn;
        out->may_spin_up = adhesion->rotors[k].uncertain;
        out->severe_loss = adhesion->loads[k].severe_loss;
    }
}

static void update_flags(struct gateway *g, int64_t now_ns)
{
    const int32_t n = g->drive_count;
    fill_train_inputs(g->integrity, g->adhesion->common_mode.state, g->train_inputs);
    gather(g);
    collect_evidence(g->rules, g->train_inputs, g->flag_inputs, n, g->evidence);
    const int changed = debounce_flags(g->rules, g->evidence, n, now_ns, g->status);
    g->changed = changed || !g->begun;
    publish(g->train_inputs, g->flag_inputs, g->evidence, n, now_ns, g->status, g->train);
    estimate_creep(g->adhesion, g->status);
    for (int32_t k = 0; k < n; k++)
        g->peak[k] = fmax(g->peak[k], g->status[k].loss_probability); /* ignores NaN */
}

static void send(struct gateway *g, int64_t now_ns)
{
    struct tx_frame *out = g->sent + g->sent_count;
    if (!g->begun)
        transmit_restart(g->transmitter, now_ns);
    g->begun = 1;
    update_counts(g->transmitter, g->receiver, g->integrity, g->load, now_ns);
    if (g->integrity->mute)
        return;
    const int frames = transmit(g->transmitter, g->status, g->train, now_ns, out);
    bus_load_transmit(g->load, g->transmitter, frames, out);
    g->sent_count += frames;
}

void finish_tick(struct gateway *g, int64_t now_ns)
{
    if (g->stage == STAGE_DETECT)
        adhesion_fuse(g->adhesion, g->receiver->drives, g->status, now_ns);
    monitor_temperatures(g->temperatures, g->receiver, now_ns, g->flag_inputs);
    update_flags(g, now_ns);
    send(g, now_ns);
    log_tick(g, g->log, now_ns);
    g->stage = STAGE_RECEIVE;
}

/* 1 if the tick has begun: it is complete, or stopped at a stage. 0: nothing was done. */
static int tick(struct gateway *g, const struct frame_columns *frames, struct frame_range rows,
                int64_t now_ns)
{
    if (!receive(g, frames, rows, now_ns))
        return 0;
    check_timeouts(g->receiver, now_ns);
    check_heartbeats(g, now_ns);
    assess_inputs(g->receiver, g->channels, g->integrity->intruder, now_ns, g->inputs);
    run_filters(g->estimator, g->receiver, g->inputs, g->estimates, now_ns);
    observe_load(g->motion, now_ns);
    if (!g->detects) {
        adhesion_prepare(g->adhesion, g->estimates, g->inputs, g->receiver->drives, g->status,
                         now_ns);
        g->stage = STAGE_DETECT;
        return 1;
    }
    detect_loss(g->adhesion, g->estimates, g->inputs, g->receiver->drives, g->status, now_ns);
    finish_tick(g, now_ns);
    return 1;
}

int64_t run(struct gateway *g, const struct frame_columns *frames, const int64_t *ends,
            int64_t ticks, int64_t now_ns)
{
    int64_t done = 0, first = 0;
    g->sent_count = 0;
    for (int32_t k = 0; k < g->drive_count; k++)
        g->peak[k] = NAN;
    while (done < ticks && g->sent_count + g->transmitter->message_count <= g->sent_capacity) {
        const struct frame_range rows = {first, ends[done] - first};
        if (!tick(g, frames, rows, now_ns + done * g->period_ns))
            break;
        first = ends[done++];
        if (g->stage != STAGE_RECEIVE || g->changed || g->receiver->tick.emergencies > 0 ||
            is_log_full(g->log))
            break;
    }
    return done;
}

int run_one(struct gateway *g, int64_t frames, int64_t *t_ns, uint32_t *can_id, uint8_t *flags,
            uint8_t *length, uint8_t *data, int64_t now_ns)
{
    const struct frame_columns columns = {
        .t_ns = t_ns, .can_id = can_id, .flags = flags, .length = length, .data = data};
    const int64_t done = run(g, &columns, &frames, 1, now_ns);
    const int left = g->stage != STAGE_RECEIVE || g->receiver->tick.emergencies > 0;
    return done ? 1 + left : 0;
}
