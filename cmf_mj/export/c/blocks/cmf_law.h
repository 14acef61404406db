/* @head@
 *
 * A cmf_law is plain memory of the caller's, any number of them. Nothing is allocated, nothing is
 * shared, and nothing but the mathematics library is called. Arrays have one entry a leg, or a
 * hydraulic mode where it says so. Lengths are extensions from neutral, positive out.
 */
#ifndef CMF_LAW_H
#define CMF_LAW_H

#define CMF_LAW_NAME "@name@"
#define CMF_LAW_LEGS @legs@
#define CMF_LAW_RATE @rate@ /* [Hz]: the constants below hold at no other */

#ifdef __cplusplus
extern "C" {
#endif

typedef double cmf_real;

typedef struct {
  cmf_real position[CMF_LAW_LEGS];     /* [m] */
  cmf_real velocity[CMF_LAW_LEGS];     /* [m/s] */
  cmf_real acceleration[CMF_LAW_LEGS]; /* [m/s^2], @gravity@ gravity */
  cmf_real cap_pressure[CMF_LAW_LEGS]; /* [Pa] gauge */
  cmf_real rod_pressure[CMF_LAW_LEGS]; /* [Pa] gauge */
} cmf_law_feedback;

typedef struct {
  cmf_real reference[CMF_LAW_LEGS]; /* demand of the legs [m] */
  cmf_law_feedback feedback;
} cmf_law_input;

typedef struct {
  cmf_real output[CMF_LAW_LEGS];  /* before the clamp, fraction of full command */
  cmf_real command[CMF_LAW_LEGS]; /* to the valves, -1 to 1; positive extends */
} cmf_law_output;

/* All that a law remembers, named as in records. */
typedef struct {
  cmf_real compensator[CMF_LAW_LEGS]; /* x */
  struct {
    cmf_real integral[CMF_LAW_LEGS];         /* by leg [m s] */
    cmf_real position_filter[CMF_LAW_LEGS];  /* [m] */
    cmf_real reference_filter[CMF_LAW_LEGS]; /* [m] */
  } error;
  cmf_real acceleration[CMF_LAW_LEGS]; /* filtered [m/s^2] */
#if MODELLED
  struct {
    cmf_real position[CMF_LAW_LEGS]; /* [m] */
    cmf_real velocity[CMF_LAW_LEGS]; /* [m/s] */
#if ADAPTING
    struct {
      cmf_real factor[CMF_LAW_LEGS];       /* of the feed-forward, less 1 */
      cmf_real error[CMF_LAW_LEGS];        /* filtered [m/s] */
      cmf_real feed_forward[CMF_LAW_LEGS]; /* filtered, fraction */
      cmf_real power[CMF_LAW_LEGS];        /* filtered square of it */
    } adaptation;
#endif
  } model;
#endif
#if PLANNED
  struct {
    cmf_real position[CMF_LAW_LEGS];         /* [m] */
    cmf_real velocity[CMF_LAW_LEGS];         /* [m/s] */
    cmf_real acceleration[CMF_LAW_LEGS];     /* [m/s^2] */
    cmf_real jerk[CMF_LAW_LEGS];             /* [m/s^3] */
    cmf_real snap[CMF_LAW_LEGS];             /* [m/s^4] */
    cmf_real reference[CMF_LAW_LEGS];        /* [m] */
    cmf_real reference_rate[CMF_LAW_LEGS];   /* [m a frame] */
    cmf_real reference_change[CMF_LAW_LEGS]; /* of that in the last frame [m a frame] */
    cmf_real demand[CMF_LAW_LEGS];           /* of the last frame [m] */
    cmf_real demand_rate[CMF_LAW_LEGS];      /* within its bound [m a frame] */
    cmf_real pose[CMF_LAW_LEGS];             /* of the platform with the planned legs [m, rad] */
  } plan;
#endif
#if DAMPED
  cmf_real load_filter[CMF_LAW_LEGS]; /* [N] */
#endif
  cmf_real offset[CMF_LAW_LEGS]; /* by leg, left of another law's output; fades */
} cmf_law_state;

typedef struct {
  cmf_law_state state;
  int started; /* whether it runs at its rate */
} cmf_law;

/* Engage the law at neutral, at rest, without pressures; elsewhere set `state` then. The rate at
 * which steps follow has to be CMF_LAW_RATE: 1 if so, else 0, and steps then command 0. */
int cmf_law_start(cmf_law *law, int rate);

/* One frame. */
void cmf_law_step(cmf_law *law, const cmf_law_input *input, cmf_law_output *output);

#ifdef __cplusplus
}
#endif
#endif
