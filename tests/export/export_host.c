/* Runs an exported machine on a file of demands and writes all channels of each frame.
 *
 * host KIND EVERY IN OUT [FAILURE AT LEG VALVE SIZE]
 * KIND is pose, reference, or host: rows of six poses, of references, or of control frame,
 * sequence, time and motion. EVERY is how many frames a step has; poses and references come a row a
 * step.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "cmf.h"

static int refused(const cmf_machine *m) { return fprintf(stderr, "%s\n", cmf_message(m)), 1; }

int main(int count, char **words) {
  if (count < 5) return 2;
  cmf_machine *m = cmf_create();
  FILE *in = fopen(words[3], "rb"), *out = fopen(words[4], "wb");
  if (!m || !in || !out) return 3;
  int host = !strcmp(words[1], "host"), posed = !strcmp(words[1], "pose");
  int width = host ? 21 : posed ? 6 : cmf_legs(), every = atoi(words[2]);
  if (host && cmf_set_input(m, CMF_HOST)) return refused(m);
  if (count > 9 &&
      cmf_inject(m, atoi(words[5]), atof(words[6]), atoi(words[7]), atoi(words[8]), atof(words[9])))
    return refused(m);
  fseek(in, 0, SEEK_END);
  long rows = ftell(in) / (8 * width), row = 0;
  double *input = malloc(8 * (size_t)(rows * width)), spent = 0.0;
  rewind(in);
  if ((long)fread(input, 8 * (size_t)width, (size_t)rows, in) != rows) return 4;
  long last = host ? (long)input[(rows - 1) * width] + 205 : rows * every;
  for (long frame = 0; frame < last; frame += every) {
    struct timespec begin, end;
    for (; host && row < rows && (long)input[row * width] <= frame; row++) {
      const double *r = input + row * width;
      if (cmf_host_frame(m, (int64_t)r[1], r[2], r + 3)) return refused(m);
    }
    const double *r = input + row * width;
    if (!host && (posed ? cmf_set_pose(m, r) : cmf_set_reference(m, r))) return refused(m);
    row += !host;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    int status = cmf_step(m, every);
    clock_gettime(CLOCK_MONOTONIC, &end);
    spent += (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec);
    if (status) return refused(m);
    for (int i = 0; i < cmf_channels(); i++) {
      const cmf_channel_info *channel = cmf_channel_at(i);
      fwrite(cmf_channel(m, channel), 8, (size_t)channel->width, out);
    }
  }
  printf("%.9f\n", spent);
  return cmf_free(m), fclose(out);
}
