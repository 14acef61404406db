/* ------------------------------------------------------------------------------------------------
 * Dynamic load pressure feedback: output -= K_f (h - z), z[k+1] = z[k] + (1 - e^(-w T)) (h - z)
 * of the load h = A_cap p_cap - A_rod p_rod@less@.
 */
#define CAP_AREA @dcl.load_feedback.cap_area@ /* [m^2] */
#define ROD_AREA @dcl.load_feedback.rod_area@ /* [m^2] */
#define LOAD_PASSES @dcl.load_feedback.filter_gain@ /* 1 - e^(-w T), w of @law.load_feedback.corner@ Hz */

/* K_f [1/N]: @law.load_feedback.gain@ %/klbf. */
static const cmf_real LOAD_GAIN[LEGS] = @dcl.load_feedback.gain@;
#if PLANNED

/* m [kg]. */
static const cmf_real LOAD_MASS[LEGS] = @dcl.load_feedback.mass@;
#endif

static void load_feedback(cmf_law_state *state, const cmf_law_feedback *feedback,
                          cmf_real output[LEGS]) {
  for (int leg = 0; leg < LEGS; leg++) {
    const cmf_real push = CAP_AREA * feedback->cap_pressure[leg];
    const cmf_real pull = ROD_AREA * feedback->rod_pressure[leg];
#if PLANNED
    const cmf_real load = (push - pull) - (LOAD_MASS[leg] * state->plan.acceleration[leg]);
#else
    const cmf_real load = push - pull;
#endif
    const cmf_real swing = load - state->load_filter[leg];
    state->load_filter[leg] += LOAD_PASSES * swing;
    output[leg] += -LOAD_GAIN[leg] * swing;
  }
}
