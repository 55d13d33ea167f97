/* Heartbeats of the drives' nodes (CiA 301): nodes that are alive, and how long silence may last.
 *
 * No function here can fail: a node's index comes from the table `row`, `gaps` is at least 0 where
 * it is divided by the constant HEARTBEAT_GAPS, and stamps are differences of two that are at
 * least 0 or are not compared. */
#include "gateway/core/supervision.h"

enum { HEARTBEAT_BASE = 0x700 };
enum { BOOT_UP = 0, STOPPED = 4, OPERATIONAL = 5, PRE_OPERATIONAL = 127 };
enum { TOGGLE = 0x80 }; /* set in every second answer to node guarding, never in a heartbeat */
enum { REPEAT_NS = 10000000 }; /* a frame so soon after another is a repetition by the controller */
#define LONGEST_NS 65536000000 /* object 0x1017 has 16 bits of ms: a longer gap is a pause */

/* Median of the last gaps, ns; of an even number the longer of the middle two; 0: there is none. */
static int64_t received_period(const struct heartbeat *node)
{
    const int64_t n = node->gaps < HEARTBEAT_GAPS ? node->gaps : HEARTBEAT_GAPS;
    int64_t median = 0;
    for (int64_t i = 0; i < n; i++) {
        const int64_t gap = node->gap_ns[i];
        int64_t rank = 0;
        for (int64_t j = 0; j < n; j++)
            rank += node->gap_ns[j] < gap || (j < i && node->gap_ns[j] == gap);
        if (rank == n / 2)
            median = gap;
    }
    return median;
}

/* Note a gap between two heartbeats; from the second consecutive one on it sets the time-out. */
static void note_gap(const struct supervision *all, struct heartbeat *node, int64_t gap_ns)
{
    /* -1 stands for its remainder, the last place, as after an answer to node guarding. Unsigned,
     * so that any lower count, which only a damaged record holds, gives a valid place, too. */
    const uint64_t place = ((uint64_t)node->gaps + HEARTBEAT_GAPS) % HEARTBEAT_GAPS;
    node->gap_ns[place] = gap_ns;
    node->gaps++;
    if (node->gaps <= 0)
        return;
    const int64_t period = all->period_ns > 0 ? all->period_ns : received_period(node);
    const int64_t limit = TIMEOUT_PERIODS * period;
    node->limit_ns = limit > all->timeout_ns ? limit : all->timeout_ns;
}

/* A gap is noted unless one of its ends is a boot-up, a node-guard answer or a change of state,
 * which some drives report at once: such a gap does not show the period. A node that answers node
 * guarding produces no heartbeat, so it is not supervised until it sends three heartbeats. */
void on_heartbeat(struct supervision *all, int32_t node, int64_t t_ns, int32_t length,
                  int32_t plain, int32_t byte)
{
    struct heartbeat *mine = &all->nodes[node];
    const int state = byte & 0x7F;
    const int known =
        state == BOOT_UP || state == STOPPED || state == OPERATIONAL || state == PRE_OPERATIONAL;
    if (!plain || length != 1 || !known) {
        all->malformed++;
        return;
    }
    mine->boots += state == BOOT_UP;
    if (t_ns < mine->last_ns)
        return;
    const int answer = (byte & TOGGLE) != 0;
    if (answer) {
        mine->gaps = -1;
        mine->limit_ns = 0;
    }
    const int64_t before = mine->since_ns;
    if (answer || mine->asked || state == BOOT_UP) {
        mine->since_ns = INT64_MIN;
    } else if (before == INT64_MIN || state != mine->state) {
        mine->since_ns = t_ns;
    } else if (t_ns - before >= REPEAT_NS) {
        mine->since_ns = t_ns;
        if (t_ns - before <= LONGEST_NS)
            note_gap(all, mine, t_ns - before);
    }
    mine->asked = 0;
    /* A drive that boots again and again has no heartbeat. */
    if (state != BOOT_UP || mine->limit_ns == 0)
        mine->last_ns = t_ns;
    mine->state = state;
}

void on_node_guard(struct supervision *all, uint32_t can_id)
{
    if (can_id < HEARTBEAT_BASE || can_id >= HEARTBEAT_BASE + HEARTBEAT_NODES)
        return;
    const int32_t node = all->row[can_id - HEARTBEAT_BASE];
    if (node >= 0)
        all->nodes[node].asked = 1;
}

int is_node_lost(const struct supervision *all, int32_t node, int64_t now_ns)
{
    const struct heartbeat *one = &all->nodes[node];
    return one->limit_ns > 0 && now_ns - one->last_ns > one->limit_ns;
}
