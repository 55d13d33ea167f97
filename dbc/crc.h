/* Checksums of AUTOSAR (SWS_CRCLibrary), a byte at a time. */
#ifndef TRACTION_CRC_H
#define TRACTION_CRC_H

#include <stdint.h>

#define CRC8_H2F_START 0xFF /* also the final inversion */
#define CRC16_START    0xFFFF

/* CRC-8, polynomial 0x2F: `crc` continued by one byte. */
uint8_t crc8_h2f(uint8_t crc, uint8_t byte);

/* CRC-16 CCITT-FALSE, polynomial 0x1021: `crc` continued by one byte. */
uint16_t crc16_ccitt(uint16_t crc, uint8_t byte);

#endif
