/* One leg is asked to move by an inch while all stand still: what the law commands. */
#include <stdio.h>

#include "cmf_law.h"

int main(void) {
  static cmf_law law;
  static cmf_law_input input;
  cmf_law_output output;
  if (!cmf_law_start(&law, CMF_LAW_RATE)) return 1;
  input.reference[0] = (cmf_real)0.0254;
  for (int frame = 0; frame < CMF_LAW_RATE; frame++) {
    cmf_law_step(&law, &input, &output);
    if (frame % (CMF_LAW_RATE / 8) == 0)
      printf("%.3f s  leg 1 %+.4f  leg 2 %+.4f of full command\n", (double)frame / CMF_LAW_RATE,
             output.command[0], output.command[1]);
  }
  return 0;
}
