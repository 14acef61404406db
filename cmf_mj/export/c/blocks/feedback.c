/* ------------------------------------------------------------------------------------------------
 * Feedback calculations: a[k+1] = pole a[k] + gain a_measured[k] (Eq 3.6), and the force
 * (p_cap - p_rod) A (Eq 3.7).
 */
#define ACCELEROMETER_POLE @dcl.feedback.accelerometer_pole@ /* a frame */
#define ACCELEROMETER_GAIN @dcl.feedback.accelerometer_gain@
#define FORCE_AREA @dcl.feedback.area@ /* A [m^2] */

static void feedback_calculations(cmf_real acceleration[LEGS], const cmf_law_feedback *feedback,
                                  signals *u) {
  for (int leg = 0; leg < LEGS; leg++) {
    const cmf_real cap = feedback->cap_pressure[leg];
    const cmf_real rod = feedback->rod_pressure[leg];
    const cmf_real filtered = acceleration[leg];
    u->of[CAP_PRESSURE][leg] = cap;
    u->of[ROD_PRESSURE][leg] = rod;
    u->of[POSITION][leg] = feedback->position[leg];
    u->of[VELOCITY][leg] = feedback->velocity[leg];
    u->of[ACCELERATION][leg] = filtered;
    u->of[FORCE][leg] = (cap - rod) * FORCE_AREA;
    acceleration[leg] =
        (ACCELEROMETER_POLE * filtered) + (ACCELEROMETER_GAIN * feedback->acceleration[leg]);
  }
}
