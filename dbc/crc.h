/* Checksums of AUTOSAR (SWS_CRCLibrary). */
#ifndef TRACTION_CRC_H
#define TRACTION_CRC_H

#include <stdint.h>

#define CRC8_H2F_START 0xFF /* also the final XOR value */
#define CRC16_START    0xFFFF

/* CRC-8, polynomial 0x2F: `crc` continued over `n` bytes. */
uint8_t crc8_h2f(uint8_t crc, const uint8_t *data, unsigned n);

/* CRC-16 CCITT-FALSE, polynomial 0x1021: `crc` continued over `n` bytes. */
uint16_t crc16_ccitt(uint16_t crc, const uint8_t *data, unsigned n);

#endif
