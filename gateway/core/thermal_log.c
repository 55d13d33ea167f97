/* Temperatures without the rest of a tick, so that a log of slow messages is read quickly.
 *
 * Nothing here can fail: the caller has made room for the frames of a tick, and a cycle is logged
 * only if there is room. */
#include "gateway/core/thermal_log.h"

#include "gateway/core/receive.h"
#include "gateway/core/thermal.h"

enum { P = THERMAL_POINTS };

/* Log motor j in its cell: row * motors + j. */
static void note_motor(struct temperature_log *log, const struct temperature_monitor *all, int j,
                       int64_t cell, int64_t now_ns)
{
    for (int q = 0; q < THERMAL_QUANTITIES; q++)
        log->second[cell * THERMAL_QUANTITIES + q] = all->motors[j].mean[q];
    for (int k = 0; k < P; k++) {
        const struct temperature_sensor *sensor = &all->sensors[j].sensor[k];
        const int64_t at = cell * P + k;
        log->mean_c[at] = all->window.mean[j * P + k];
        log->known[at] = all->window.known[j * P + k];
        log->value_c[at] = sensor->value_c;
        log->held_ns[at] = now_ns - sensor->changed_ns;
    }
}

void note_temperature_cycle(struct temperature_log *log, const struct temperature_monitor *all,
                            int64_t now_ns)
{
    if (all->cycles == log->cycles)
        return;
    log->cycles = all->cycles;
    const int n = all->drive_count;
    const int64_t row = log->count++;
    log->second_complete[row] = all->second_complete;
    for (int j = 0; j < n; j++)
        note_motor(log, all, j, row * n + j, now_ns);
}

int64_t run_temperatures(struct gateway *g, struct temperature_log *log,
                         const struct frame_columns *frames, const int64_t *ends, int64_t ticks,
                         int64_t now_ns)
{
    int64_t done = 0, first = 0;
    for (; done < ticks && log->count < log->capacity; done++) {
        const int64_t at_ns = now_ns + done * g->period_ns;
        if (!receive_frames(g->receiver, frames, first, ends[done] - first, at_ns))
            break;
        first = ends[done];
        check_timeouts(g->receiver, at_ns);
        const int received = receive_temperatures(g->temperatures, g->receiver);
        advance_temperatures(g->temperatures, g->receiver, received, at_ns);
        note_temperature_cycle(log, g->temperatures, at_ns);
    }
    return done;
}
