/* Thermal networks of the simulator: heat flows between the nodes of a motor and to the air.
 *
 * No function here can fail: capacities are constants above 0, and indices are loop variables. */
#include "sim/physics/thermal.h"

enum { WINDING = 0, CORE = 1, FRAME = 2, BEARING_DE = 3, BEARING_NDE = 4, ROTOR = 5 };
enum { AIR = SIM_NODES, COLUMNS = SIM_NODES + 1 };

void sim_heat_step(int64_t motors, const double *sources, const double *links,
                   const double *capacity, const double *air_c, double dt, double *temperatures)
{
    for (int64_t m = 0; m < motors; m++) {
        const double *q = &sources[m * SIM_NODES];
        const double *link = &links[m * SIM_NODES * COLUMNS];
        double *t = &temperatures[m * SIM_NODES], flow[SIM_NODES];
        for (int a = 0; a < SIM_NODES; a++) {
            flow[a] = q[a] + link[a * COLUMNS + AIR] * (air_c[m] - t[a]);
            for (int b = 0; b < SIM_NODES; b++)
                flow[a] += link[a * COLUMNS + b] * (t[b] - t[a]);
        }
        for (int a = 0; a < SIM_NODES; a++)
            t[a] += dt * flow[a] / capacity[a];
    }
}

/* One step of motor m of a record; t: its temperatures. */
static void record_step(const struct sim_heat_record *r, int64_t step, int64_t m, double *t)
{
    const int64_t at = step * r->motors + m;
    const double iron = r->iron[step], air_c = r->air_c[at];
    double flow[SIM_NODES];
    for (int a = 0; a < SIM_NODES; a++) {
        flow[a] = m == r->fault_motor && a == r->fault_node ? r->fault_w[step] : 0.0;
        for (int b = 0; b < SIM_NODES; b++)
            flow[a] += r->links[a * SIM_NODES + b] * (t[b] - t[a]);
    }
    flow[WINDING] += r->copper[at] * (1.0 + r->copper_slope * (t[WINDING] - r->copper_reference));
    flow[CORE] += (1.0 - r->rotor_share) * iron;
    flow[ROTOR] += r->rotor_share * iron;
    flow[FRAME] += r->cooling[at] * (air_c - t[FRAME]);
    for (int a = BEARING_DE; a <= BEARING_NDE; a++)
        flow[a] += r->friction[at] + r->bearing_air * (air_c - t[a]);
    for (int a = 0; a < SIM_NODES; a++)
        t[a] += r->dt_s * flow[a] / r->capacity[a];
}

void sim_heat_record(const struct sim_heat_record *record, double *temperatures, double *out)
{
    const int64_t width = record->motors * SIM_NODES;
    int64_t k = 0;
    for (int64_t step = 0; step < record->steps; step++) {
        for (int64_t m = 0; m < record->motors; m++)
            record_step(record, step, m, &temperatures[m * SIM_NODES]);
        for (; k < record->samples && record->at[k] == step; k++) {
            for (int64_t j = 0; j < width; j++)
                out[k * width + j] = temperatures[j];
        }
    }
}
