/* Prediction of one motor's interacting filters over a block. */
#ifndef TRACTION_THERMAL_IMM_PREDICT_H
#define TRACTION_THERMAL_IMM_PREDICT_H

#include "gateway/core/records.h"

/* Quantities that are the same for all modes of one block. */
struct imm_prediction {
    double gain[THERMAL_LUMPS][THERMAL_LUMPS]; /* s, response to a steady heat */
    double keep;                      /* share of a disturbance that is left after the block */
    double F[IMM_STATES][IMM_STATES]; /* transition matrix, without the column of a heat's size */
};

/* Compute the quantities that are the same for all modes of a block with these surroundings. */
void imm_prepare(const struct imm_config *config, const struct imm_surroundings *around,
                 struct imm_prediction *out);

/* Predict mode g by one block. */
void imm_predict(const struct imm_config *config, const struct imm_surroundings *around,
                 const struct imm_prediction *by, int g, const struct imm_state *before,
                 struct imm_state *after);

#endif
