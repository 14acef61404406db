/* Heave by a decimetre and back, again and again; after two seconds without the pump. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "cmf.h"

static int failure(const char *name) {
  for (int i = 0; i < cmf_failures(); i++)
    if (!strcmp(cmf_failure_at(i)->name, name)) return i;
  return -1;
}

int main(void) {
  cmf_machine *machine = cmf_create();
  if (!machine) return fprintf(stderr, "no memory, or another version of MuJoCo\n"), 1;
  const cmf_channel_info *supply = cmf_find_channel("supply_pressure");
  const cmf_channel_info *legs = cmf_find_channel("leg_extension");
  if (cmf_inject(machine, failure("pump_lost"), 2.0, 0, 0, 0.0))
    fprintf(stderr, "%s\n", cmf_message(machine));

  for (int frame = 0; frame < 4 * CMF_RATE; frame++) {
    double t = frame / CMF_RATE, up = 0.05 * (1.0 - cos(3.14159265 * t));
    double pose[6] = {0.0, 0.0, -up, 0.0, 0.0, 0.0}; /* z is down */
    if (cmf_set_pose(machine, pose) || cmf_step(machine, 1)) {
      fprintf(stderr, "%s\n", cmf_message(machine));
      break;
    }
    if (frame % (int)(CMF_RATE / 2) == 0)
      printf("%4.1f s  leg 1 %+8.5f %s  supply %6.2f MPa\n", t, cmf_channel(machine, legs)[0],
             legs->unit, 1e-6 * cmf_channel(machine, supply)[0]);
  }
  cmf_free(machine);
  return 0;
}
