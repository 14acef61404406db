/* ------------------------------------------------------------------------------------------------
 * Hydraulic modes: q = V^T l of demand and feedback, l = V q of outputs. V^T has a row a mode, of
 * @modes.frequency@ Hz.
 */
static const cmf_real SHAPE[LEGS][LEGS] = @dcl.shape@;

static void to_modes(const cmf_real legs[LEGS], cmf_real modes[LEGS]) {
  for (int mode = 0; mode < LEGS; mode++) {
    cmf_real total = 0.0;
    for (int leg = 0; leg < LEGS; leg++) {
      total += SHAPE[mode][leg] * legs[leg];
    }
    modes[mode] = total;
  }
}

static void to_legs(const cmf_real modes[LEGS], cmf_real legs[LEGS]) {
  for (int leg = 0; leg < LEGS; leg++) {
    cmf_real total = 0.0;
    for (int mode = 0; mode < LEGS; mode++) {
      total += SHAPE[mode][leg] * modes[mode];
    }
    legs[leg] = total;
  }
}

static void feedback_to_modes(const cmf_law_feedback *legs, cmf_law_feedback *modes) {
  to_modes(legs->position, modes->position);
  to_modes(legs->velocity, modes->velocity);
  to_modes(legs->acceleration, modes->acceleration);
  to_modes(legs->cap_pressure, modes->cap_pressure);
  to_modes(legs->rod_pressure, modes->rod_pressure);
}
