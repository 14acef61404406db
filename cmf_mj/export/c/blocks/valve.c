/* ------------------------------------------------------------------------------------------------
 * Valve calculations: commands within full command (section 2.3.3). What is left of the output of
 * a law that was in force before fades.
 */
#define OFFSET_STAYS @dcl.offset_decay@ /* a frame */

static void valve_calculations(cmf_real offset[LEGS], cmf_law_output *output) {
  for (int leg = 0; leg < LEGS; leg++) {
    if (offset[leg] != 0.0) {
      output->output[leg] += offset[leg];
      offset[leg] *= OFFSET_STAYS;
    }
    output->command[leg] = within(output->output[leg], -1.0, 1.0);
  }
}
