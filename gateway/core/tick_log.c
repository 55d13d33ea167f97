/* Log of ticks for a report: what is sent, and additional data that no frame contains.
 *
 * Nothing here can fail: a full log accepts no tick. */
#include "gateway/core/tick_log.h"

#include <math.h>

#include "estimators/thermal/trend.h"
#include "gateway/core/busload.h"
#include "gateway/core/thermal.h"

/* Log the degradation of drive j relative to the others, while its temperatures are fresh. */
static void log_degradation(const struct temperature_monitor *all, int j, double limit_k,
                            struct drive_row *out)
{
    const struct motor_temperatures *motor = &all->motors[j];
    const int known = all->method == THERMAL_MODEL && motor->fresh;
    out->degradation_k_h = known ? trend_rate_k_h(&motor->trend) : NAN;
    out->degradation_sigma_k_h = known ? trend_sigma_k_h(&motor->trend) : NAN;
    out->hours_to_limit = known ? trend_hours_to(&motor->trend, limit_k) : NAN;
}

static void log_readings(const struct receiver *receiver, struct drive_row *drives)
{
    for (int64_t k = 0; k < receiver->tick.temperatures; k++) {
        const int64_t row = receiver->temperature_rows[k];
        struct drive_row *drive = &drives[receiver->channels[receiver->channel[row]].drive];
        for (int point = 0; point < READING_POINTS; point++)
            drive->celsius[point] = reading_c(receiver, row, point);
    }
}

int is_log_full(const struct tick_log *log)
{
    return log && log->count >= log->capacity;
}

void log_tick(const struct gateway *g, struct tick_log *log, int64_t now_ns)
{
    if (!log || is_log_full(log))
        return;
    const int32_t n = g->drive_count;
    struct drive_row *drives = &log->drives[log->count * n];
    for (int32_t j = 0; j < n; j++) {
        drives[j].status = g->status[j];
        log_degradation(g->temperatures, j, log->limit_k, &drives[j]);
        for (int point = 0; point < READING_POINTS; point++)
            drives[j].celsius[point] = NAN;
    }
    log_readings(g->receiver, drives);
    log->ticks[log->count++] = (struct tick_row){
        .t_ns = now_ns,
        .bus_load_percent = bus_load_percent(g->load, now_ns),
        .train = *g->train,
    };
}
