/* Temperatures without the rest of a tick: a record of slow messages costs what its frames cost.
 *
 * Nothing here can fail: the caller has made room for the frames of a tick, and a cycle is noted only
 * where there is room. */
#include "gateway/core/thermal_log.h"

#include <string.h>

#include "gateway/core/receive.h"
#include "gateway/core/thermal.h"

enum { P = THERMAL_POINTS };

void note_temperature_cycle(struct temperature_log *log, const struct temperature_monitor *all,
                            int64_t now_ns)
{
    if (all->cycles == log->cycles)
        return;
    log->cycles = all->cycles;
    const int n = all->drive_count;
    const int64_t row = log->count++;
    log->second_complete[row] = all->second_complete;
    memcpy(log->mean_c + row * n * P, all->window.mean, sizeof(double) * (size_t)(n * P));
    memcpy(log->known + row * n * P, all->window.known, (size_t)(n * P));
    for (int j = 0; j < n; j++) {
        const int64_t cell = row * n + j;
        memcpy(log->second + cell * THERMAL_QUANTITIES, all->motors[j].mean,
               sizeof all->motors[j].mean);
        for (int k = 0; k < P; k++) {
            log->value_c[cell * P + k] = all->sensors[j].sensor[k].value_c;
            log->held_ns[cell * P + k] = now_ns - all->sensors[j].sensor[k].changed_ns;
        }
    }
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
