/* Eight bytes as one number, in both byte orders, and floating-point numbers as their bits. Each
 * function compiles to one or two instructions. */
#ifndef TRACTION_BYTES_H
#define TRACTION_BYTES_H

#include <stdint.h>

/* The first byte is the least significant one. */
static inline uint64_t load_little(const uint8_t *bytes)
{
    return (uint64_t)bytes[0] | (uint64_t)bytes[1] << 8 | (uint64_t)bytes[2] << 16 |
           (uint64_t)bytes[3] << 24 | (uint64_t)bytes[4] << 32 | (uint64_t)bytes[5] << 40 |
           (uint64_t)bytes[6] << 48 | (uint64_t)bytes[7] << 56;
}

/* The first byte is the most significant one. */
static inline uint64_t load_big(const uint8_t *bytes)
{
    return (uint64_t)bytes[0] << 56 | (uint64_t)bytes[1] << 48 | (uint64_t)bytes[2] << 40 |
           (uint64_t)bytes[3] << 32 | (uint64_t)bytes[4] << 24 | (uint64_t)bytes[5] << 16 |
           (uint64_t)bytes[6] << 8 | (uint64_t)bytes[7];
}

static inline void store_little(uint8_t *bytes, uint64_t number)
{
    bytes[0] = (uint8_t)number;
    bytes[1] = (uint8_t)(number >> 8);
    bytes[2] = (uint8_t)(number >> 16);
    bytes[3] = (uint8_t)(number >> 24);
    bytes[4] = (uint8_t)(number >> 32);
    bytes[5] = (uint8_t)(number >> 40);
    bytes[6] = (uint8_t)(number >> 48);
    bytes[7] = (uint8_t)(number >> 56);
}

static inline void store_big(uint8_t *bytes, uint64_t number)
{
    bytes[0] = (uint8_t)(number >> 56);
    bytes[1] = (uint8_t)(number >> 48);
    bytes[2] = (uint8_t)(number >> 40);
    bytes[3] = (uint8_t)(number >> 32);
    bytes[4] = (uint8_t)(number >> 24);
    bytes[5] = (uint8_t)(number >> 16);
    bytes[6] = (uint8_t)(number >> 8);
    bytes[7] = (uint8_t)number;
}

/* Copy `length` bytes, a multiple of 8; word by word, as a pointer to bytes may alias anything. */
static inline void copy_words(uint8_t *to, const uint8_t *from, int length)
{
    for (int b = 0; b < length; b += 8)
        store_little(to + b, load_little(from + b));
}

static inline double double_of_bits(uint64_t bits)
{
    const union {
        uint64_t bits;
        double number;
    } same = {.bits = bits};
    return same.number;
}

static inline uint64_t bits_of_double(double number)
{
    const union {
        double number;
        uint64_t bits;
    } same = {.number = number};
    return same.bits;
}

static inline float float_of_bits(uint32_t bits)
{
    const union {
        uint32_t bits;
        float number;
    } same = {.bits = bits};
    return same.number;
}

static inline uint32_t bits_of_float(float number)
{
    const union {
        float number;
        uint32_t bits;
    } same = {.number = number};
    return same.bits;
}

#endif
