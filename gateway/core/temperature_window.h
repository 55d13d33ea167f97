/* Window averages of the motors' temperatures, and MAISD of them. */
#ifndef TRACTION_TEMPERATURE_WINDOW_H
#define TRACTION_TEMPERATURE_WINDOW_H

#include "gateway/core/records.h"

/* Note the sensors that are near the others': they measure a motor, and a later rise is heat. */
void note_near(struct temperature_monitor *all);

/* Add the newest values to the window, and compare the motors that are driven. */
void advance_window(struct temperature_monitor *all);

#endif
