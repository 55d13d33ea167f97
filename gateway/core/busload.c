/* Share of the bus in use over the last full second, with worst-case bit stuffing.
 *
 * Nothing here can fail: a length of 8 bits is below DATA_LENGTHS, and a window that is a divisor
 * is at least a second long. */
#include "gateway/core/busload.h"

#include <math.h>

#include "gateway/core/receive.h"

#define SECOND_NS    1000000000
#define MOST_PERCENT 126.0 /* one below the signal's not-available code */

/* Time from the start of the window, ns. It wraps if a record holds nonsense. */
static int64_t window_ns(const struct bus_load *load, int64_t now_ns)
{
    return (int64_t)((uint64_t)now_ns - (uint64_t)load->since_ns);
}

void bus_load_tick(struct bus_load *load, int64_t now_ns)
{
    const int64_t window = window_ns(load, now_ns);
    if (window < SECOND_NS)
        return;
    const double percent = 100.0 * load->busy_s * SECOND_NS / (double)window;
    load->percent = percent < MOST_PERCENT ? percent : MOST_PERCENT;
    load->since_ns = now_ns;
    load->busy_s = 0.0;
}

void bus_load_receive(struct bus_load *load, const struct receiver *receiver,
                      const struct frame_columns *block, int64_t first, int64_t count)
{
    for (int64_t i = first; i < first + count; i++)
        if (!receiver || lookup_id(receiver, block->can_id[i], block->flags[i]) != ID_OWN)
            bus_load_send(load, block->flags[i] & FRAME_FD, block->length[i]);
}

void bus_load_send(struct bus_load *load, int fd, uint8_t length)
{
    load->busy_s += fd ? load->fd_s[length] : load->classic_s[length];
}

void bus_load_transmit(struct bus_load *load, const struct transmitter *tx, int frames,
                       const struct tx_frame *frame)
{
    for (int k = 0; k < frames; k++) {
        const struct e2e_config *config = &tx->messages[frame[k].message].e2e_config;
        bus_load_send(load, config->fd, (uint8_t)config->length);
    }
}

double bus_load_percent(const struct bus_load *load, int64_t now_ns)
{
    return window_ns(load, now_ns) <= 2 * (int64_t)SECOND_NS ? load->percent : NAN;
}
