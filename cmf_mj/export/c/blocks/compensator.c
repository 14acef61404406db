/* ------------------------------------------------------------------------------------------------
 * Compensator calculations: x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k] (Eqs 2.3 and 2.4).
 * The published gains stand behind those in SI.
 */
#define STATE_GAIN @dcl.compensator.state_gain@ /* A, a frame */
#define OUTPUT_GAIN @dcl.compensator.output_gain@ /* C [fraction] @law.output_gain@ % */

static const cmf_real INPUT_GAIN[SIGNALS]@per_mode@ = { /* B */
@input_gain@
};

static const cmf_real DIRECT_GAIN[SIGNALS]@per_mode@ = { /* D [fraction] */
@direct_gain@
};

static void compensator_calculations(cmf_real state[LEGS], const signals *u,
                                     cmf_real output[LEGS]) {
  for (int leg = 0; leg < LEGS; leg++) {
    cmf_real sum = OUTPUT_GAIN * state[leg];
    cmf_real following = STATE_GAIN * state[leg];
    for (int signal = 0; signal < SIGNALS; signal++) {
      sum += DIRECT_GAIN[signal]@by_mode@ * u->of[signal][leg];
      following += INPUT_GAIN[signal]@by_mode@ * u->of[signal][leg];
    }
    output[leg] = sum;
    state[leg] = following;
  }
}
