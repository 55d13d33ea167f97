/* C structures of SocketCAN (linux/can.h) to the columns of a block of frames.
 *
 * No function here can fail: no message is read beyond its size, no control data beyond
 * `control_size`, and lengths are those that a frame can have, whatever the length byte is. */
#include "dbc/socketcan.h"

#define CLASSIC_BYTES    16 /* struct can_frame */
#define FD_BYTES         72 /* struct canfd_frame */
#define MAX_DATA_CLASSIC 8
#define MAX_DLC          15
#define ID_EXTENDED      0x80000000u
#define ID_REMOTE        0x40000000u
#define ID_ERROR         0x20000000u
#define ID_MASK_EXTENDED 0x1FFFFFFFu
#define ID_MASK          0x7FFu
#define FD_BRS           1 /* flags of struct canfd_frame */
#define FD_ESI           2
#define LEVEL_SOCKET     1    /* SOL_SOCKET */
#define TYPE_STAMP       35   /* SO_TIMESTAMPNS */
#define TYPE_DROPS       40   /* SO_RXQ_OVFL */
#define TRUNCATED        0x20 /* MSG_TRUNC: the message was longer than a frame */
#define SECOND_NS        1000000000

/* ---- Control messages (cmsg(3)) ---- */

struct control_head {
    size_t bytes; /* of the head and its data */
    int level;
    int type;
};

struct control_stamp {
    long seconds;
    long nanoseconds;
};

/* Evaluate one control message with `size` bytes of data; both are aligned as a long is. */
static void note_control(const struct control_head *head, const void *data, size_t size,
                         int64_t *stamp_ns, struct socket_counts *counts)
{
    if (head->level != LEVEL_SOCKET)
        return;
    if (head->type == TYPE_STAMP && size >= sizeof(struct control_stamp)) {
        const struct control_stamp *stamp = data;
        /* Wraps if the kernel's numbers are nonsense. */
        *stamp_ns = (int64_t)((uint64_t)stamp->seconds * SECOND_NS + (uint64_t)stamp->nanoseconds);
    }
    if (head->type == TYPE_DROPS && size >= sizeof(uint32_t)) {
        const uint32_t drops = *(const uint32_t *)data;
        counts->dropped += drops - (uint32_t)counts->drops_seen; /* the counter wraps */
        counts->drops_seen = drops;
    }
}

/* The kernel's stamp, ns; 0: none. Counts the frames that the kernel has dropped. */
static int64_t read_control(const struct socket_header *header, struct socket_counts *counts)
{
    int64_t stamp_ns = 0;
    size_t at = 0; /* a multiple of a long's size */
    while (at + sizeof(struct control_head) <= header->control_size) {
        const void *here = header->control + at;
        const struct control_head *head = here;
        if (head->bytes < sizeof *head || head->bytes > header->control_size - at)
            break;
        note_control(head, head + 1, head->bytes - sizeof *head, &stamp_ns, counts);
        at += (head->bytes + sizeof(long) - 1) / sizeof(long) * sizeof(long);
    }
    return stamp_ns;
}

/* ---- Frames ---- */

/* enum frame_flag of a frame. */
static int frame_flags(const struct socket_frame *frame, int fd)
{
    if (frame->id & ID_ERROR)
        return FRAME_ERROR;
    int flags = frame->id & ID_EXTENDED ? FRAME_EXTENDED : 0;
    if (!fd)
        return flags | (frame->id & ID_REMOTE ? FRAME_REMOTE : 0);
    flags |= frame->flags & FD_BRS ? FRAME_BRS : 0;
    flags |= frame->flags & FD_ESI ? FRAME_ESI : 0;
    return flags | FRAME_FD;
}

/* DLC of a classic frame if the number of its data bytes does not show it, else -1. */
static int raw_dlc(const struct socket_frame *frame, int flags)
{
    if (flags & (FRAME_FD | FRAME_ERROR))
        return -1;
    const int length = frame->length, raw = frame->raw_length;
    if (length == MAX_DATA_CLASSIC && raw > MAX_DATA_CLASSIC && raw <= MAX_DLC)
        return raw;
    if (!(flags & FRAME_REMOTE) || length == 0)
        return -1;
    return length < MAX_DATA_CLASSIC ? length : MAX_DATA_CLASSIC;
}

/* Number of data bytes of a frame. */
static int data_bytes(const struct socket_frame *frame, int flags)
{
    const int most = flags & FRAME_FD ? PAYLOAD_BYTES : MAX_DATA_CLASSIC;
    if (flags & FRAME_REMOTE)
        return 0;
    return frame->length < most ? frame->length : most;
}

static void unpack_frame(const struct socket_frame *frame, int fd, const struct frame_columns *rows,
                         int64_t row)
{
    const int flags = frame_flags(frame, fd);
    const int bytes = data_bytes(frame, flags);
    const int is_long = (frame->id & (ID_EXTENDED | ID_ERROR)) != 0;
    rows->can_id[row] = frame->id & (is_long ? ID_MASK_EXTENDED : ID_MASK);
    rows->flags[row] = (uint8_t)flags;
    rows->length[row] = (uint8_t)bytes;
    rows->dlc[row] = (int8_t)raw_dlc(frame, flags);
    rows->channel[row] = 0;
    uint8_t *out = &rows->data[row * PAYLOAD_BYTES];
    for (int k = 0; k < PAYLOAD_BYTES; k++)
        out[k] = k < bytes ? frame->data[k] : 0;
}

/* Age of a frame with this stamp of the kernel, ns; 0 for a frame without a stamp. */
static int64_t age(const struct socket_clock *clock, int64_t stamp_ns)
{
    const int64_t ns = (int64_t)((uint64_t)clock->real_ns - (uint64_t)stamp_ns);
    if (stamp_ns == 0 || ns < 0)
        return 0;
    return ns < clock->max_age_ns ? ns : clock->max_age_ns;
}

void unpack_frames(struct socket_message *messages, int n, size_t control_capacity,
                   const struct socket_clock *clock, const struct frame_columns *rows,
                   struct socket_counts *counts)
{
    *counts = (struct socket_counts){.drops_seen = counts->drops_seen};
    for (int k = 0; k < n; k++) {
        struct socket_header *header = &messages[k].head;
        const int64_t stamp_ns = read_control(header, counts);
        header->control_size = control_capacity;
        const uint32_t size = messages[k].size;
        if (header->flags & TRUNCATED || (size != CLASSIC_BYTES && size != FD_BYTES)) {
            counts->malformed++;
            continue;
        }
        const int64_t row = counts->frames++;
        rows->t_ns[row] = clock->now_ns - age(clock, stamp_ns);
        unpack_frame(header->vector->frame, size == FD_BYTES, rows, row);
        counts->errors += (rows->flags[row] & FRAME_ERROR) != 0;
    }
}
