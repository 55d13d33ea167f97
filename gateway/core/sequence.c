/* Signs of a second sender of one message.
 *
 * Each counter step takes a sender one period. With two senders, at least one counter per period
 * jumps ahead, or stands still, too soon; a jump because of lost frames comes late. A restart of
 * the sender is one sign. Nothing here can fail: stamps are at least -1, sums are bounded. */
#include "gateway/core/sequence.h"

#define GUARD_NS 1000000000 /* after the last sign, frames of the message are rejected so long */
enum { SECOND_SENDER = 3 }; /* signs, each within GUARD_NS of the one before */
/* Sum at which identical frames are a sign: each repeat adds 2, each new frame subtracts 1. So five
 * in a row, or two synchronous senders of equal values; not a controller that repeats some. */
enum { MAX_REPEATS = 6 };

/* Count an identical frame; 1 if it is a sign. */
static int is_repeated_too_often(struct sequence_guard *guard)
{
    guard->repeats += 2;
    if (guard->repeats > MAX_REPEATS + 1)
        guard->repeats = MAX_REPEATS + 1;
    if (guard->repeats < MAX_REPEATS)
        return 0;
    guard->errors = SECOND_SENDER;
    return 1;
}

/* 1 if a counter that is this number of steps ahead is a sign. */
static int is_too_soon(struct sequence_guard *guard, int64_t t_ns, int32_t step)
{
    const int64_t passed = t_ns - guard->counter_ns;
    guard->counter_ns = t_ns;
    if (step <= E2E_MAX_DELTA) {
        guard->repeats -= guard->repeats > 0;
        return 0;
    }
    if ((double)passed >= step * guard->shortest_step_ns)
        return 0;
    if (t_ns - guard->error_ns > GUARD_NS)
        guard->errors = 0;
    guard->errors++;
    return 1;
}

void guard_sequence(struct sequence_guard *guard, int64_t t_ns, int32_t step, int32_t identical)
{
    if (!(identical ? is_repeated_too_often(guard) : is_too_soon(guard, t_ns, step)))
        return;
    guard->error_ns = t_ns;
    if (guard->errors >= SECOND_SENDER)
        guard->rejected_until_ns = t_ns > INT64_MAX - GUARD_NS ? INT64_MAX : t_ns + GUARD_NS;
}
