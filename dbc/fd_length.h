/* Lengths of the data of a CAN FD frame. */
#ifndef TRACTION_FD_LENGTH_H
#define TRACTION_FD_LENGTH_H

#include <stdint.h>

/* 1 if a CAN FD frame can have this number of data bytes (ISO 11898-1). */
static inline int is_fd_length(int64_t length)
{
    switch (length) {
    case 12:
    case 16:
    case 20:
    case 24:
    case 32:
    case 48:
    case 64:
        return 1;
    default:
        return length <= 8;
    }
}

#endif
