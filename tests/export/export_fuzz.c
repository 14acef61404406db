/* Calls an FMU in the order that its input says: a length, so many bytes, one call a few of them.
 * An answer of one byte follows each sequence; memory must be sound at its end. */
#include <math.h>
#include <stdio.h>

#define main unused
#include "fmi2.c"
#undef main

static const double numbers[] = {0.0, 0.0125, 1.0 / 2048.0, 1e-12, -0.0125, 1.0,     0.3,
                                 2.0, -3.0,   1e6,          1e300, NAN,     INFINITY};

static void hush(void *e, String name, Status status, String category, String text, ...) {
  (void)e, (void)name, (void)status, (void)category, (void)text;
}

typedef struct {
  const unsigned char *next, *end;
} input_t;

static unsigned byte(input_t *in) { return in->next < in->end ? *in->next++ : 0; }
static double number(input_t *in) { return numbers[byte(in) % (sizeof numbers / 8)]; }

static void sequence(input_t *in) {
  Callbacks calls = {hush, NULL, NULL, NULL, NULL};
  Component f = NULL;
  unsigned char *state = NULL;
  double time = 0.0, x = 0.01;
  unsigned settle = FMU_INPUTS;
  int n;
  if (byte(in) % 4) { /* most sequences begin with a machine that runs */
    f = fmi2Instantiate("f", 1, FMU_TOKEN, NULL, &calls, 0, 0);
    fmi2SetReal(f, &settle, 1, &x);
    fmi2SetupExperiment(f, 0, 0.0, 0.0, 0, 0.0);
    fmi2EnterInitializationMode(f);
    fmi2ExitInitializationMode(f);
  }
  while (in->next < in->end) {
    unsigned call = byte(in), ref = byte(in) % 4 ? byte(in) : byte(in) * 256 + byte(in);
    size_t size;
    switch (call % 20) {
      case 0:
        if (!f) f = fmi2Instantiate("f", 1, byte(in) % 8 ? FMU_TOKEN : "?", NULL, &calls, 0, 1);
        if (f) x = 0.01, fmi2SetReal(f, &settle, 1, &x); /* settle */
        break;
      case 1:
        fmi2SetupExperiment(f, 0, 0.0, time = number(in), (int)byte(in) % 2, number(in));
        break;
      case 2:
      case 3:
        fmi2EnterInitializationMode(f);
        break;
      case 4:
      case 5:
        fmi2ExitInitializationMode(f);
        break;
      case 6:
      case 7:
      case 8:
        if (f && byte(in) % 4) time = f->now.time;
        x = number(in);
        fmi2DoStep(f, time, x == 1e6 ? 1e7 : x / 8.0, 0); /* a million would be allowed */
        break;
      case 9:
        x = number(in);
        if (ref != FMU_INPUTS) fmi2SetReal(f, &ref, 1, &x);
        break;
      case 10:
        fmi2GetReal(f, &ref, 1, &x);
        break;
      case 11:
        n = (int)byte(in) - 3, ref = byte(in) % 3 ? FIRST_FAILURE + ref % 20 : ref;
        fmi2SetInteger(f, &ref, 1, &n);
        break;
      case 12:
        fmi2GetInteger(f, &ref, 1, &n);
        break;
      case 13:
        n = (int)byte(in) % 3, ref = HOST;
        fmi2SetBoolean(f, &ref, 1, &n);
        fmi2GetBoolean(f, &ref, 1, &n);
        break;
      case 14:
        fmi2GetFMUstate(f, &state);
        break;
      case 15:
        if (state) fmi2SetFMUstate(f, state);
        break;
      case 16:
        if (f && state && !fmi2SerializedFMUstateSize(f, state, &size)) {
          unsigned char *bytes = malloc(size);
          fmi2SerializeFMUstate(f, state, bytes, byte(in) % 8 ? size : size - 1);
          if (byte(in) % 2) bytes[(ref * 131u) % size] ^= (unsigned char)byte(in);
          fmi2DeSerializeFMUstate(f, bytes, byte(in) % 8 ? size : size / 2, &state);
          free(bytes);
        }
        break;
      case 17:
        fmi2Reset(f);
        if (f) x = 0.01, fmi2SetReal(f, &settle, 1, &x);
        break;
      case 18:
        fmi2Terminate(f);
        break;
      default:
        fmi2FreeInstance(f);
        f = NULL;
    }
  }
  fmi2FreeFMUstate(f, &state);
  fmi2FreeInstance(f);
}

int main(void) {
  static unsigned char bytes[65536];
  unsigned char head[2];
  while (fread(head, 1, 2, stdin) == 2) {
    size_t size = head[0] + 256u * head[1];
    if (fread(bytes, 1, size, stdin) != size) return 2;
    input_t in = {bytes, bytes + size};
    sequence(&in);
    putchar('.');
    fflush(stdout);
  }
  return 0;
}
