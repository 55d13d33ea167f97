/* Validity of temperature sensors: lost, stuck or off, alone or with all others of their drive. */
#ifndef TRACTION_TEMPERATURE_H
#define TRACTION_TEMPERATURE_H

#include "gateway/core/records.h"

/* Reset to nothing received; constants stay. */
void temperature_reset(struct temperature_drive *drive);

/* Count a reading of the drive that came at t_ns; its values follow. */
void temperature_add_reading(struct temperature_drive *drive, int64_t t_ns);

/* Add the valid value of configured sensor k of that reading, degC; raw: in tenths. */
void temperature_add_value(struct temperature_drive *drive, int k, int64_t t_ns, double value_c,
                           int64_t raw);

/* The steps of sensor k were its return to where it belongs: it has no offset. */
void temperature_forget_offset(struct temperature_drive *drive, int k);

/* Fault of sensor k: an enum fault_class. FAULT_UNKNOWN if it has never been received, FAULT_NONE
 * if there is no such sensor. */
int temperature_sensor_fault(const struct temperature_drive *drive, int k, int64_t now_ns);

/* First sensor fault of the drive: an enum fault_class, FAULT_NONE if there is none. */
int temperature_fault(const struct temperature_drive *drive, int64_t now_ns);

/* Sensor with that fault: an enum fault_sensor. FAULT_ON_NONE if all sensors of the drive, at
 * least two, have been off or lost since the same moment: a common part has failed. */
int temperature_fault_sensor(const struct temperature_drive *drive, int64_t now_ns);

/* 1 while a configured sensor has never given a valid value. */
int temperature_not_yet_valid(const struct temperature_drive *drive);

/* Fill values_c and valid (drives, THERMAL_POINTS): last values, and 1 if the sensor is configured,
 * was received and has no fault. */
void temperature_values(const struct temperature_drive *drive, int drives, int64_t now_ns,
                        double *values_c, uint8_t *valid);

/* Stamp of the last reading; INT64_MIN: none. */
int64_t temperature_received_ns(const struct temperature_drive *drive);

#endif
