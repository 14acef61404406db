/* ------------------------------------------------------------------------------------------------
 * Limit calculations: demands within the working stroke (section 3.2.1).
 */
#define TRAVEL @dcl.error.travel@ /* [m] working stroke either way */

static void limit_calculations(const cmf_real demand[LEGS], cmf_real limited[LEGS]) {
  for (int leg = 0; leg < LEGS; leg++) {
    limited[leg] = within(demand[leg], -TRAVEL, TRAVEL);
  }
}
