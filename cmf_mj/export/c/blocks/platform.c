/* ------------------------------------------------------------------------------------------------
 * The platform that the planned legs carry: its pose, tracked by one chord step a frame, and the
 * Jacobian there, J, of l' = J (velocity, angular velocity) in axes of the platform.
 */
#define FARTHEST @farthest@ /* [m, rad] beyond which the pose starts again from neutral */
#define HALF_STROKE @dcl.plan.inverse.half_stroke@ /* [m] */
#define CAP_SHARE @dcl.plan.inverse.cap_share@ /* cap area over both areas */

typedef struct {
  cmf_real of[LEGS][LEGS];
} matrix;

/* Upper gimbals in the platform and lower ones below it [m], x forward, y right, z down. */
static const cmf_real UPPER_GIMBAL[LEGS][3] = @dcl.plan.inverse.geometry.upper@;
static const cmf_real LOWER_GIMBAL[LEGS][3] = @dcl.plan.inverse.geometry.lower@;
static const cmf_real NEUTRAL_LENGTH[LEGS] = @dcl.plan.inverse.geometry.neutral@;

/* Pose per leg motion at neutral [m/m, rad/m]. */
static const cmf_real CHORD[LEGS][LEGS] = @dcl.plan.inverse.chord@;

/* Inertia of the platform with its legs, platform axes [kg, kg m, kg m^2]. */
static const matrix INERTIA = {@dcl.plan.inverse.inertia@};

/* Platform axes to inertial axes, Euler order yaw, pitch, roll (Eq 2.2). */
static void turn_of(const cmf_real pose[LEGS], cmf_real turn[3][3]) {
  const cmf_real cos_roll = cos(pose[3]);
  const cmf_real sin_roll = sin(pose[3]);
  const cmf_real cos_pitch = cos(pose[4]);
  const cmf_real sin_pitch = sin(pose[4]);
  const cmf_real cos_yaw = cos(pose[5]);
  const cmf_real sin_yaw = sin(pose[5]);
  turn[0][0] = cos_pitch * cos_yaw;
  turn[0][1] = ((sin_roll * sin_pitch) * cos_yaw) - (cos_roll * sin_yaw);
  turn[0][2] = ((cos_roll * sin_pitch) * cos_yaw) + (sin_roll * sin_yaw);
  turn[1][0] = cos_pitch * sin_yaw;
  turn[1][1] = ((sin_roll * sin_pitch) * sin_yaw) + (cos_roll * cos_yaw);
  turn[1][2] = ((cos_roll * sin_pitch) * sin_yaw) - (sin_roll * cos_yaw);
  turn[2][0] = -sin_pitch;
  turn[2][1] = sin_roll * cos_pitch;
  turn[2][2] = cos_roll * cos_pitch;
}

/* Extensions of the pose, and the rows of J there (Eq C.6). */
static void legs_of_pose(const cmf_real pose[LEGS], cmf_real legs[LEGS], matrix *jacobian) {
  cmf_real turn[3][3];
  turn_of(pose, turn);
  for (int leg = 0; leg < LEGS; leg++) {
    cmf_real arm[3];
    cmf_real line[3];
    cmf_real cross[3];
    for (int i = 0; i < 3; i++) {
      arm[i] = ((turn[i][0] * UPPER_GIMBAL[leg][0]) + (turn[i][1] * UPPER_GIMBAL[leg][1])) +
               (turn[i][2] * UPPER_GIMBAL[leg][2]);
      line[i] = (pose[i] + arm[i]) - LOWER_GIMBAL[leg][i];
    }
    const cmf_real length =
        sqrt(((line[0] * line[0]) + (line[1] * line[1])) + (line[2] * line[2]));
    legs[leg] = length - NEUTRAL_LENGTH[leg];
    for (int i = 0; i < 3; i++) {
      line[i] = line[i] / length;
    }
    cross[0] = (arm[1] * line[2]) - (arm[2] * line[1]);
    cross[1] = (arm[2] * line[0]) - (arm[0] * line[2]);
    cross[2] = (arm[0] * line[1]) - (arm[1] * line[0]);
    for (int i = 0; i < 3; i++) {
      jacobian->of[leg][i] =
          ((turn[0][i] * line[0]) + (turn[1][i] * line[1])) + (turn[2][i] * line[2]);
      jacobian->of[leg][i + 3] =
          ((turn[0][i] * cross[0]) + (turn[1][i] * cross[1])) + (turn[2][i] * cross[2]);
    }
  }
}

/* Gauss and Jordan with row pivots; `source` is overwritten. */
static void invert(matrix *source, matrix *inverse) {
  for (int i = 0; i < LEGS; i++) {
    for (int j = 0; j < LEGS; j++) {
      inverse->of[i][j] = (i == j) ? 1.0 : 0.0;
    }
  }
  for (int column = 0; column < LEGS; column++) {
    int best = column;
    for (int i = column + 1; i < LEGS; i++) {
      if (fabs(source->of[i][column]) > fabs(source->of[best][column])) {
        best = i;
      }
    }
    for (int j = 0; j < LEGS; j++) {
      const cmf_real up = source->of[best][j];
      const cmf_real right = inverse->of[best][j];
      source->of[best][j] = source->of[column][j];
      inverse->of[best][j] = inverse->of[column][j];
      source->of[column][j] = up;
      inverse->of[column][j] = right;
    }
    const cmf_real scale = 1.0 / source->of[column][column];
    for (int j = 0; j < LEGS; j++) {
      source->of[column][j] *= scale;
      inverse->of[column][j] *= scale;
    }
    for (int i = 0; i < LEGS; i++) {
      const cmf_real factor = source->of[i][column];
      if ((i != column) && (factor != 0.0)) {
        for (int j = 0; j < LEGS; j++) {
          source->of[i][j] -= factor * source->of[column][j];
          inverse->of[i][j] -= factor * inverse->of[column][j];
        }
      }
    }
  }
}

/* J^-1 at the pose, which then moves a chord's step towards the planned legs. */
static void follow_pose(cmf_real pose[LEGS], const cmf_real planned[LEGS], matrix *reciprocal) {
  cmf_real legs[LEGS];
  matrix jacobian;
  int sound = 1;
  legs_of_pose(pose, legs, &jacobian);
  for (int i = 0; i < LEGS; i++) {
    for (int j = 0; j < LEGS; j++) {
      pose[i] += CHORD[i][j] * (planned[j] - legs[j]);
    }
    if (!(fabs(pose[i]) < FARTHEST)) {
      sound = 0;
    }
  }
  if (sound == 0) {
    for (int i = 0; i < LEGS; i++) {
      pose[i] = 0.0;
    }
  }
  invert(&jacobian, reciprocal);
}

static void times(const matrix *left, const cmf_real vector[LEGS], cmf_real product[LEGS]) {
  for (int i = 0; i < LEGS; i++) {
    cmf_real total = 0.0;
    for (int j = 0; j < LEGS; j++) {
      total += left->of[i][j] * vector[j];
    }
    product[i] = total;
  }
}

static void transposed_times(const matrix *left, const cmf_real vector[LEGS],
                             cmf_real product[LEGS]) {
  for (int j = 0; j < LEGS; j++) {
    cmf_real total = 0.0;
    for (int i = 0; i < LEGS; i++) {
      total += left->of[i][j] * vector[i];
    }
    product[j] = total;
  }
}

typedef struct {
  cmf_real spring;
  cmf_real leak;
} oil;

/* Spring and leak rate of a leg's oil over those at neutral, at its extension over half stroke. */
static oil oil_at(cmf_real stroke) {
  const cmf_real cap = 1.0 + stroke;
  const cmf_real rod = 1.0 - stroke;
  oil found;
  if (fabs(stroke) >= 1.0) {
    found.spring = 1.0;
    found.leak = 1.0;
  } else {
    found.spring = (CAP_SHARE / cap) + ((1.0 - CAP_SHARE) / rod);
    found.leak = 1.0 / (found.spring * ((cap * rod) * (cap * rod)));
  }
  return found;
}
