/* An FMU of a mechanism after FMI 3.0: model exchange, and co-simulation with steps of its own.

   What is included before this file (by model.c) is written at the export:

     N_VALUES, N_INPUTS     numbers that can be set: inputs, then parameters
     N_STATES, N_CONTINUOUS entries of the flat state; those whose errors are judged (the work put in comes behind)
     N_BODIES, N_START, N_OUTPUTS, N_CONTACTS, N_CROSSINGS, N_CORRECTIONS, HAS_ROOM, READS_TIME, N_STAGES, ORDER, TOKEN
     IS_DRIVEN, FAR, FAR_TURNED, NOTICEABLE, RADIUS    which changes of a start are told
     body_names, start_values, value_names, relative, absolute, nominal, stage_times, stage_weights, weights, error_weights
     and the functions legal, described, newton_step, velocities, gaps, open_gap, first_memory, rate, crossing, after, correction,
     outputs, vitals, room, each with what depends on the values alone ahead.

   Value references: 0 time; then the values; then outputs, states, their derivatives, event indicators.

   Never wrong in silence: numbers that are not finite, starts that do not close, steps that shrink to rounding, energy
   from nowhere, constraints that do not hold and balls outside of their sockets end a step with fmi3Discard (or a call
   with fmi3Error) and a message; the state stays that of the last instant that was sound. */

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#if defined(FMI3_FUNCTION_PREFIX) /* linked statically: names must differ between FMUs */
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define FMI(name) JOIN(FMI3_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif

typedef uint32_t Reference;
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef void (*Log)(void *environment, Status status, const char *category, const char *message);

#define AT_LEAST_ONE(n) ((n) > 0 ? (n) : 1)

enum {
  FIRST_VALUE = 1,
  FIRST_OUTPUT = FIRST_VALUE + N_VALUES,
  FIRST_STATE = FIRST_OUTPUT + N_OUTPUTS,
  FIRST_RATE = FIRST_STATE + N_STATES,
  FIRST_INDICATOR = FIRST_RATE + N_STATES,
  END = FIRST_INDICATOR + N_CROSSINGS
};

typedef enum { INSTANTIATED, INITIALIZING, EVENT_MODE, CONTINUOUS_TIME, STEPPING, TERMINATED } Mode;

/* All that changes; copied as one block by get and set of the FMU's state. */
typedef struct {
  double values[AT_LEAST_ONE(N_VALUES)];
  double t, t_start, y[N_STATES];
  double step;                                  /* size of the next trial step [s]; 0: to be found */
  double lowest, highest, bottom, top, agitation; /* of the audit [J] */
  bool is_audited, has_start, is_start_changed;
  Mode mode;
} State;

typedef struct {
  State now;
  bool is_ahead_known, is_model_exchange;
  void *environment;
  Log log;
  bool logs;
  double legal_ahead[AT_LEAST_ONE(legal_ahead_size)];
  double described_ahead[AT_LEAST_ONE(described_ahead_size)];
  double newton_ahead[AT_LEAST_ONE(newton_step_ahead_size)];
  double velocities_ahead[AT_LEAST_ONE(velocities_ahead_size)];
  double gaps_ahead[AT_LEAST_ONE(gaps_ahead_size)];
  double open_ahead[AT_LEAST_ONE(open_gap_ahead_size)];
  double memory_ahead[AT_LEAST_ONE(first_memory_ahead_size)];
  double rate_ahead_[AT_LEAST_ONE(rate_ahead_size)];
  double crossing_ahead_[AT_LEAST_ONE(crossing_ahead_size)];
  double after_ahead_[AT_LEAST_ONE(after_ahead_size)];
  double correction_ahead_[AT_LEAST_ONE(correction_ahead_size)];
  double outputs_ahead_[AT_LEAST_ONE(outputs_ahead_size)];
  double vitals_ahead_[AT_LEAST_ONE(vitals_ahead_size)];
  double room_ahead_[AT_LEAST_ONE(room_ahead_size)];
} Instance;

static void say(Instance *c, Status status, const char *format, ...) {
  static const char *categories[] = {"logAll", "logStatusWarning", "logStatusDiscard", "logStatusError",
                                     "logStatusFatal"};
  char text[512];
  va_list arguments;
  if (!c->log || (status == OK && !c->logs)) return;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  c->log(c->environment, status, categories[status], text);
}

/* What follows from the values alone, once for each change of them. */
static void look_ahead(Instance *c) {
  const double *v = c->now.values;
  if (c->is_ahead_known) return;
  legal_ahead(v, c->legal_ahead);
  described_ahead(v, c->described_ahead);
  newton_step_ahead(v, c->newton_ahead);
  velocities_ahead(v, c->velocities_ahead);
  gaps_ahead(v, c->gaps_ahead);
  open_gap_ahead(v, c->open_ahead);
  first_memory_ahead(v, c->memory_ahead);
  rate_ahead(v, c->rate_ahead_);
  crossing_ahead(v, c->crossing_ahead_);
  after_ahead(v, c->after_ahead_);
  correction_ahead(v, c->correction_ahead_);
  outputs_ahead(v, c->outputs_ahead_);
  vitals_ahead(v, c->vitals_ahead_);
  room_ahead(v, c->room_ahead_);
  c->is_ahead_known = true;
}

#define AT(function, ahead, y, out) function(c->ahead, c->now.values, &t, y, out)

static void rate_at(Instance *c, double t, const double *y, double *out) { AT(rate, rate_ahead_, y, out); }

/* Values, rates, and whether each counts as touching, of contacts and then touches. */
static void crossing_at(Instance *c, double t, const double *y, double *out) { AT(crossing, crossing_ahead_, y, out); }

static bool all_finite(const double *x, int n) {
  for (int i = 0; i < n; i++)
    if (!is_finite(x[i])) return false;
  return true;
}

/* No NaN; what is unlimited may be infinite. */
static bool all_numbers(const double *x, int n) {
  for (int i = 0; i < n; i++)
    if (!is_finite(x[i]) && !(x[i] > 0) && !(x[i] < 0)) return false;
  return true;
}

/* ---- The start --------------------------------------------------------------------------------------------------- */

static bool values_are_legal(Instance *c) {
  double is_legal = 0, t = c->now.t, none = 0;
  look_ahead(c);
  for (int i = 0; i < N_VALUES; i++)
    if (!is_finite(c->now.values[i])) {
      say(c, ERROR, "%s is not finite", value_names[i]);
      return false;
    }
  AT(legal, legal_ahead, &none, &is_legal);
  if (is_legal > 0) return true;
  say(c, ERROR, "a number is not valid, for instance a mass or a clearance that is not positive: %s",
      "sj.simulate with the same values names it");
  return false;
}

enum { PLACES = 7, RATES = 6, RATES_BEGIN = PLACES * N_BODIES }; /* of a body: position and quaternion; velocities */

static double length_of(const double *a, const double *b, double sign, int n) {
  double sum = 0;
  for (int i = 0; i < n; i++) sum += (a[i] - sign * (b ? b[i] : 0)) * (a[i] - sign * (b ? b[i] : 0));
  return sqrt(sum);
}

/* The largest speed among the bodies' translations and, at RADIUS, rotations [m/s]; of which body. */
static double largest_speed(const double *a, const double *b, int *which) {
  double found = 0;
  for (int i = 0; i < N_BODIES; i++) {
    int k = RATES_BEGIN + RATES * i;
    double speed = fmax(length_of(a + k, b ? b + k : NULL, 1, 3),
                        RADIUS * length_of(a + k + 3, b ? b + k + 3 : NULL, 1, 3));
    if (speed > found) {
      found = speed;
      *which = i;
    }
  }
  return found;
}

/* Says what the joints change of the positions and velocities that the values describe, as `simulate` warns of it. */
static void tell_changes(Instance *c, const double *described, const double *taken) {
  double t = c->now.t, farthest = 0, moved = 0, turned = 0, open = 0, asked, change;
  int which = 0;
  for (int i = 0; i < N_BODIES; i++) {
    const double *a = taken + PLACES * i, *b = described + PLACES * i;
    double distance = length_of(a, b, 1, 3);
    double angle = 2 * fmin(length_of(a + 3, b + 3, 1, 4), length_of(a + 3, b + 3, -1, 4)); /* q and -q are one turn */
    double share = fmax(distance / FAR, angle / FAR_TURNED);
    if (share > farthest) farthest = share, moved = distance, turned = angle, which = i;
  }
  /* A driver may put a mechanism where its motion begins; the other joints must close as they are described. */
  if (IS_DRIVEN) AT(open_gap, open_ahead, described, &open);
  if (farthest > 1 && (!IS_DRIVEN || open > FAR)) {
    c->now.is_start_changed = true;
    say(c, WARNING, "where the values put the bodies the joints do not close, and the bodies were moved: %s by %.3g m "
        "and %.3g rad; set parameters that close the joints", body_names[which], moved, turned);
  }
  asked = largest_speed(described, NULL, &which);
  change = largest_speed(described, taken, &which);
  if (change > NOTICEABLE * asked && asked > 0) {
    const double *a = taken + RATES_BEGIN + RATES * which, *b = described + RATES_BEGIN + RATES * which;
    c->now.is_start_changed = true;
    say(c, WARNING, "the joints do not allow the velocities at the start, and what they do not allow was removed: %s "
        "starts with (%.4g, %.4g, %.4g) m/s and (%.4g, %.4g, %.4g) rad/s instead of (%.4g, %.4g, %.4g) m/s and "
        "(%.4g, %.4g, %.4g) rad/s; set velocities that agree, or export the joint with starts_concentric=False",
        body_names[which], a[0], a[1], a[2], a[3], a[4], a[5], b[0], b[1], b[2], b[3], b[4], b[5]);
  }
}

static bool start(Instance *c) {
  double y[AT_LEAST_ONE(N_START)], moved[AT_LEAST_ONE(N_START)], gap = 0, t = c->now.t;
  double as_described[AT_LEAST_ONE(N_START)];
  State *now = &c->now;
  if (now->has_start) return true;
  if (!values_are_legal(c)) return false;
  memset(y, 0, sizeof y); /* `described` reads nothing of it */
  AT(described, described_ahead, y, as_described);
  memcpy(y, as_described, sizeof y);
  for (int k = 0; k < N_NEWTON_STEPS; k++) {
    AT(newton_step, newton_ahead, y, moved);
    memcpy(y, moved, sizeof y);
  }
  AT(velocities, velocities_ahead, y, moved);
  AT(gaps, gaps_ahead, moved, &gap);
  if (!is_finite(gap) || !(gap < CLOSING_TOLERANCE) || !all_finite(moved, N_START)) {
    say(c, ERROR, "the joints cannot be closed at the start: a residual of %.3g remains; check the parameters that "
        "place bodies and joints, and drivers that contradict each other", gap);
    return false;
  }
  memset(now->y, 0, sizeof now->y);
  memcpy(now->y, moved, N_START * sizeof(double));
  {
    double memory[AT_LEAST_ONE(N_MEMORY)];
    AT(first_memory, memory_ahead, now->y, memory);
    for (int i = 0; i < N_MEMORY; i++) now->y[N_START + i] = memory[i];
  }
  now->step = 0;
  now->is_audited = false;
  now->has_start = true;
  now->is_start_changed = false;
  tell_changes(c, as_described, moved);
  return true;
}

/* ---- The audit --------------------------------------------------------------------------------------------------- */

enum { VITALS, N_VITALS }; /* as `Vitals` of motion/integration/audit.py has them */

/* Whether what is seen can be; energy only where `with_energy`. */
static bool is_sound(Instance *c, double t, const double *y, bool with_energy, Status status) {
  double v[N_VITALS], energy, constant;
  State *now = &c->now;
  AT(vitals, vitals_ahead_, y, v);
  energy = v[POTENTIAL] + v[AGITATION];
  constant = TRACKS_CONSTRAINT_WORK ? v[CONSTRAINT_WORK] : energy; /* what does not fall in an exact motion */
  if (!all_finite(y, N_STATES) || !all_numbers(v, N_VITALS) || !is_finite(energy)) {
    say(c, status, "at t = %.9g s: numbers are not finite", t);
    return false;
  }
  if (v[VIOLATION] > LARGEST_VIOLATION || v[FRICTION] > 1) {
    say(c, status, "at t = %.9g s: the joints' equations are violated by %.3g, which is more than %.3g m or rad", t,
        v[VIOLATION], LARGEST_VIOLATION);
    return false;
  }
  if (v[NORM] > LARGEST_NORM) {
    say(c, status, "at t = %.9g s: a body's quaternion lost its norm", t);
    return false;
  }
  if (v[ROTATIONS] > 1) {
    say(c, status, "at t = %.9g s: a bushing was turned by more than its law is for", t);
    return false;
  }
  if (v[TURNS] > 1) {
    say(c, status, "at t = %.9g s: how often an angle about an axis has gone round is in doubt: take smaller steps", t);
    return false;
  }
  if (v[OUTSIDE] > LARGEST_OUTSIDE) {
    say(c, status, "at t = %.9g s: a ball is outside its socket without contact: an event was passed over", t);
    return false;
  }
  if (!with_energy || !is_finite(ENERGY_SHARE)) return true;
  if (!now->is_audited) {
    now->lowest = energy;
    now->highest = constant;
    now->bottom = now->top = v[POTENTIAL];
    now->agitation = v[AGITATION];
    now->is_audited = true;
    return true;
  }
  now->lowest = fmin(now->lowest, energy);
  now->highest = fmax(now->highest, constant);
  now->bottom = fmin(now->bottom, v[POTENTIAL]);
  now->top = fmax(now->top, v[POTENTIAL]);
  now->agitation = fmax(now->agitation, v[AGITATION]);
  {
    double moving = fmax(now->agitation + now->top - now->bottom, LEAST_ENERGY);
    if (energy - now->lowest > moving * ENERGY_SHARE) {
      say(c, status, "at t = %.9g s: the energy rose by more than was put in, by %.3g J", t, energy - now->lowest);
      return false;
    }
    if (is_finite(LOSS_SHARE) && now->highest - constant > moving * LOSS_SHARE) {
      say(c, status, "at t = %.9g s: energy vanished that no part took, %.3g J", t, now->highest - constant);
      return false;
    }
  }
  return true;
}

/* ---- Steps of co-simulation -------------------------------------------------------------------------------------- */

/* One step of the explicit method; returns the error as a share of the tolerance. */
static double try_step(Instance *c, double t, const double *y, double h, double *end) {
  static const int n = N_STATES;
  double k[N_STAGES][N_STATES], stage[N_STATES], sum = 0;
  const double *a = stage_weights;
  for (int s = 0; s < N_STAGES; s++) {
    for (int i = 0; i < n; i++) {
      double slope = 0;
      for (int r = 0; r < s; r++) slope += a[r] * k[r][i];
      stage[i] = y[i] + h * slope;
    }
    a += s;
    rate_at(c, t + stage_times[s] * h, stage, k[s]);
  }
  for (int i = 0; i < n; i++) {
    double slope = 0, error = 0;
    for (int s = 0; s < N_STAGES; s++) {
      slope += weights[s] * k[s][i];
      error += error_weights[s] * k[s][i];
    }
    end[i] = y[i] + h * slope;
    if (i < N_CONTINUOUS) {
      double share = h * error / (absolute[i] + relative[i] * fmax(fabs(y[i]), fabs(end[i])));
      sum += share * share;
    }
  }
  return all_finite(end, n) ? sqrt(sum / N_CONTINUOUS) : INFINITY;
}

/* The size of the first step: a hundredth of what changes the state by its own size (Hairer). */
static double first_step(Instance *c) {
  double f[N_STATES], size = 0, slope = 0;
  const double *y = c->now.y;
  rate_at(c, c->now.t, y, f);
  for (int i = 0; i < N_CONTINUOUS; i++) {
    double scale = absolute[i] + relative[i] * fabs(y[i]);
    size += (y[i] / scale) * (y[i] / scale);
    slope += (f[i] / scale) * (f[i] / scale);
  }
  return size > 1e-10 && slope > 1e-10 ? 0.01 * sqrt(size / slope) : 1e-6;
}

/* The largest value of side * g within a step by the cubic through its ends, and where. */
static double cubic_peak(double g0, double r0, double g1, double r1, double h, double *where) {
  double peak = -INFINITY;
  for (int k = 1; k < 32; k++) {
    double s = k / 32.0, q = 1 - s;
    double g = (1 + 2 * s) * q * q * g0 + s * q * q * h * r0 + s * s * (3 - 2 * s) * g1 - s * s * q * h * r1;
    if (g > peak) {
      peak = g;
      *where = s * h;
    }
  }
  return peak;
}

/* The end of a step that just passes the zero of one crossing: on `side` at 0, beyond at `high`. */
static double landing(Instance *c, double t, const double *y, int which, double side, double g0, double high,
                      double *end) {
  double g[AT_LEAST_ONE(3 * N_CROSSINGS)], low = 0, at_low = g0, at_high, weight = 1;
  int last = 0;
  try_step(c, t, y, high, end);
  crossing_at(c, t + high, end, g);
  at_high = g[which];
  for (int k = 0; k < 100 && fabs(at_high) > LANDING_WINDOW && high - low > 4e-16 * fmax(fabs(t), high); k++) {
    /* Illinois, and a bisection now and then against slow progress */
    double share = at_low * weight / (at_low * weight - at_high);
    double h = k % 4 == 3 || !(share > 0 && share < 1) ? (low + high) / 2 : low + share * (high - low);
    double trial[N_STATES];
    try_step(c, t, y, h, trial);
    crossing_at(c, t + h, trial, g);
    if (side * g[which] < 0 || (side > 0 && g[which] == 0)) {
      high = h;
      at_high = g[which];
      memcpy(end, trial, sizeof trial);
      weight = last == 1 ? weight / 2 : 1;
      last = 1;
    } else {
      low = h;
      at_low = g[which];
      weight = last == -1 ? 2 * weight : 1;
      last = -1;
    }
  }
  return high;
}

/* Ends a trial step where a contact begins or ends first; also one that only begins and ends within it. */
static double first_event(Instance *c, double t, const double *y, double h, double *end) {
  double before[AT_LEAST_ONE(3 * N_CROSSINGS)], after_[AT_LEAST_ONE(3 * N_CROSSINGS)];
  if (N_CROSSINGS == 0) return h;
  crossing_at(c, t, y, before);
  for (int turn = 0; turn < 2 * N_CROSSINGS; turn++) {
    bool has_event = false;
    crossing_at(c, t + h, end, after_);
    for (int i = 0; i < N_CROSSINGS && !has_event; i++) {
      double side = before[2 * N_CROSSINGS + i] > 0 ? 1 : -1, g0 = before[i], g1 = after_[i], where = 0;
      if (side * g0 < 0) continue; /* it begins this step on the other side: its memory follows at the end */
      if (side * g1 < 0) {
        if (fabs(g1) <= LANDING_WINDOW) continue;
        h = landing(c, t, y, i, side, g0, h, end);
        has_event = true;
      } else if (cubic_peak(-side * g0, -side * before[N_CROSSINGS + i], -side * g1, -side * after_[N_CROSSINGS + i], h,
                            &where) > 0) {
        double trial[N_STATES], g[3 * N_CROSSINGS];
        try_step(c, t, y, where, trial);
        crossing_at(c, t + where, trial, g);
        if (side * g[i] < 0) {
          h = landing(c, t, y, i, side, g0, where, end);
          has_event = true;
        }
      }
    }
    if (!has_event) break;
  }
  return h;
}

/* The memory of contacts after a step from y to end. */
static void remember(Instance *c, double t, const double *y, double *end) {
  double packed[2 * N_STATES + AT_LEAST_ONE(N_CONTACTS)], memory[AT_LEAST_ONE(N_MEMORY)];
  if (N_CONTACTS == 0) return;
  memcpy(packed, y, N_STATES * sizeof(double));
  memcpy(packed + N_STATES, end, N_STATES * sizeof(double));
  for (int i = 0; i < N_CONTACTS; i++) packed[2 * N_STATES + i] = 0;
  AT(after, after_ahead_, packed, memory);
  for (int i = 0; i < N_MEMORY; i++) end[N_START + i] = memory[i];
}

static void correct(Instance *c, double t, double *y) {
  double moved[N_STATES];
  for (int k = 0; k < N_CORRECTIONS; k++) {
    AT(correction, correction_ahead_, y, moved);
    memcpy(y, moved, sizeof moved);
  }
}

static Status advance(Instance *c, double t_end) {
  State *now = &c->now;
  double end[N_STATES];
  long n = 0;
  look_ahead(c);
  if (!is_sound(c, now->t, now->y, true, DISCARD)) return DISCARD;
  remember(c, now->t, now->y, now->y);
  if (now->step <= 0) now->step = first_step(c);
  while (now->t < t_end) {
    double t = now->t, left = t_end - t, h = fmin(now->step, left), error, made, free_of = INFINITY;
    bool is_last;
    if (HAS_ROOM) AT(room, room_ahead_, now->y, &free_of);
    if (free_of > 0) h = fmin(h, free_of);
    if (READS_TIME) h = fmin(h, LONGEST_STEP);
    is_last = h >= left;
    if (++n > MAX_STEPS) {
      say(c, DISCARD, "at t = %.9g s: %ld steps were not enough for one communication step; shorten it, loosen rtol= "
          "of the export, or let the importer integrate (model exchange) with a stiff method", t, (long)MAX_STEPS);
      return DISCARD;
    }
    error = try_step(c, t, now->y, h, end);
    if (!(error <= 1)) {
      now->step = h * (is_finite(error) ? fmax(0.2, 0.9 * pow(error, -1.0 / ORDER)) : 0.1);
      if (now->step < 1e-15 * fmax(fabs(t), 1e-3)) {
        say(c, DISCARD, "at t = %.9g s: the step size shrank to the rounding of time: the accelerations are not finite "
            "or grow without bound there", t);
        return DISCARD;
      }
      continue;
    }
    made = first_event(c, t, now->y, h, end);
    correct(c, t + made, end);
    remember(c, t + made, now->y, end);
    {
      double t_new = is_last && made >= h ? t_end : t + made;
      if (!is_sound(c, t_new, end, true, DISCARD)) return DISCARD;
      memcpy(now->y, end, sizeof end);
      now->t = t_new;
    }
    /* A step that was cut short by the end or an event says nothing against the size before. */
    {
      double factor = error > 0 ? fmin(10.0, fmax(0.2, 0.9 * pow(error, -1.0 / ORDER))) : 10.0;
      now->step = made < h || is_last ? fmax(now->step, h * factor) : h * factor;
      if (made < h) now->step = fmin(now->step, h);
    }
  }
  return OK;
}

/* ---- FMI 3.0 ----------------------------------------------------------------------------------------------------- */

static void reset(Instance *c) {
  memset(&c->now, 0, sizeof c->now);
  for (int i = 0; i < N_VALUES; i++) c->now.values[i] = start_values[i];
  c->is_ahead_known = false;
}

/* Whether NaN is seen in comparisons; the compiler cannot know the numbers beforehand. */
static bool takes_nan_for_nan(void) {
  volatile double zero = 0, infinite = INFINITY;
  double nan = infinite * zero;
  return nan != nan && !(nan > 0) && !(nan <= 0) && !is_finite(nan) && !is_finite(infinite) && is_finite(zero);
}

/* Whether products and sums are contracted: (1 + 2^-30)^2 - (1 + 2^-29) is 2^-60 without a rounding between. */
static bool contracts(void) {
  volatile double x = 1 + 0x1p-30, rounded = -(1 + 0x1p-29);
  double a = x, b = x, c = rounded;
  return a * b + c != 0;
}

static Instance *instantiate(const char *token, bool logs, void *environment, Log log, bool is_model_exchange) {
  Instance *c;
  if (!token || strcmp(token, TOKEN) != 0) {
    if (log) log(environment, ERROR, "logStatusError", "the instantiation token is not that of this FMU");
    return NULL;
  }
  if (!takes_nan_for_nan()) {
    if (log)
      log(environment, ERROR, "logStatusError", "this FMU was compiled with arithmetic that takes no number for NaN "
          "(-ffast-math or the like), where nothing wrong would be noticed; compile its source without");
    return NULL;
  }
  c = calloc(1, sizeof *c);
  if (!c) return NULL;
  if (log && contracts())
    log(environment, WARNING, "logStatusWarning", "this FMU was compiled with fused multiply-add, and contacts may "
        "begin and end without end; compile its source with -ffp-contract=off");
  c->environment = environment;
  c->log = log;
  c->logs = logs;
  c->is_model_exchange = is_model_exchange;
  reset(c);
  return c;
}

EXPORT const char *FMI(fmi3GetVersion)(void) { return "3.0"; }

EXPORT Status FMI(fmi3SetDebugLogging)(Instance *c, bool logs, size_t n, const char *const categories[]) {
  (void)n, (void)categories;
  c->logs = logs;
  return OK;
}

EXPORT Instance *FMI(fmi3InstantiateModelExchange)(const char *name, const char *token, const char *resources,
                                                    bool visible, bool logs, void *environment, Log log) {
  (void)name, (void)resources, (void)visible;
  return instantiate(token, logs, environment, log, true);
}

EXPORT Instance *FMI(fmi3InstantiateCoSimulation)(const char *name, const char *token, const char *resources,
                                                   bool visible, bool logs, bool event_mode, bool early_return,
                                                   const Reference required[], size_t n_required, void *environment,
                                                   Log log, void *intermediate) {
  (void)name, (void)resources, (void)visible, (void)event_mode, (void)early_return, (void)required, (void)n_required;
  (void)intermediate;
  if (!HAS_CO_SIMULATION) {
    if (log) log(environment, ERROR, "logStatusError", "this FMU is for model exchange only");
    return NULL;
  }
  return instantiate(token, logs, environment, log, false);
}

EXPORT Instance *FMI(fmi3InstantiateScheduledExecution)(const char *name, const char *token, const char *resources,
                                                         bool visible, bool logs, void *environment, Log log,
                                                         void *update, void *lock, void *unlock) {
  (void)name, (void)token, (void)resources, (void)visible, (void)logs, (void)update, (void)lock, (void)unlock;
  if (log) log(environment, ERROR, "logStatusError", "this FMU has no scheduled execution");
  return NULL;
}

EXPORT void FMI(fmi3FreeInstance)(Instance *c) { free(c); }

EXPORT Status FMI(fmi3EnterInitializationMode)(Instance *c, bool has_tolerance, double tolerance, double t,
                                                bool has_stop, double stop) {
  (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
  if (c->now.mode != INSTANTIATED || !is_finite(t)) {
    say(c, ERROR, "fmi3EnterInitializationMode: not now, or a start time that is not finite");
    return ERROR;
  }
  c->now.t = c->now.t_start = t;
  c->now.has_start = false;
  c->now.mode = INITIALIZING;
  return OK;
}

EXPORT Status FMI(fmi3ExitInitializationMode)(Instance *c) {
  if (c->now.mode != INITIALIZING) return ERROR;
  if (!start(c)) return ERROR;
  if (!is_sound(c, c->now.t, c->now.y, false, ERROR)) return ERROR;
  c->now.mode = c->is_model_exchange ? EVENT_MODE : STEPPING;
  return c->now.is_start_changed ? WARNING : OK;
}

EXPORT Status FMI(fmi3Terminate)(Instance *c) {
  c->now.mode = TERMINATED;
  return OK;
}

EXPORT Status FMI(fmi3Reset)(Instance *c) {
  reset(c);
  return OK;
}

/* While flying, contact begins a little beyond the surface, and ends a little within: what the importer finds lies on
   the far side, whatever its tolerance, and is no event twice. */
static void indicators_at(Instance *c, double *out) {
  double g[AT_LEAST_ONE(3 * N_CROSSINGS)];
  if (N_CROSSINGS == 0) return;
  crossing_at(c, c->now.t, c->now.y, g);
  for (int i = 0; i < N_CROSSINGS; i++)
    out[i] = i < N_CONTACTS ? g[i] + (g[2 * N_CROSSINGS + i] > 0 ? HYSTERESIS : -HYSTERESIS) : g[i];
}

EXPORT Status FMI(fmi3GetFloat64)(Instance *c, const Reference refs[], size_t n, double values[], size_t n_values) {
  double found[AT_LEAST_ONE(N_OUTPUTS)], rates[N_STATES], indicators[AT_LEAST_ONE(N_CROSSINGS)];
  bool has_outputs = false, has_rates = false, has_indicators = false;
  double t = c->now.t;
  if (n != n_values) return ERROR;
  look_ahead(c);
  for (size_t i = 0; i < n; i++) {
    Reference r = refs[i];
    if (r >= END) {
      say(c, ERROR, "there is no variable with the value reference %u", (unsigned)r);
      return ERROR;
    }
    if (r >= FIRST_OUTPUT && !c->now.has_start && (c->now.mode != INITIALIZING || !start(c))) {
      say(c, ERROR, "outputs and states are known from the initialization on");
      return ERROR;
    }
    if (r == 0) values[i] = t;
    else if (r < FIRST_OUTPUT) values[i] = c->now.values[r - FIRST_VALUE];
    else if (r < FIRST_STATE) {
      if (!has_outputs) AT(outputs, outputs_ahead_, c->now.y, found);
      has_outputs = true;
      values[i] = found[r - FIRST_OUTPUT];
    } else if (r < FIRST_RATE) values[i] = c->now.y[r - FIRST_STATE];
    else if (r < FIRST_INDICATOR) {
      if (!has_rates) rate_at(c, t, c->now.y, rates);
      has_rates = true;
      values[i] = rates[r - FIRST_RATE];
    } else {
      if (!has_indicators) indicators_at(c, indicators);
      has_indicators = true;
      values[i] = indicators[r - FIRST_INDICATOR];
    }
    if (!is_finite(values[i])) {
      say(c, ERROR, "the variable with the value reference %u is not finite at t = %.9g s", (unsigned)r, t);
      return ERROR;
    }
  }
  return OK;
}

EXPORT Status FMI(fmi3SetFloat64)(Instance *c, const Reference refs[], size_t n, const double values[],
                                   size_t n_values) {
  bool has_changed = false;
  State before = c->now;
  if (n != n_values) return ERROR;
  for (size_t i = 0; i < n; i++) {
    Reference r = refs[i];
    if (r < FIRST_VALUE || r >= FIRST_OUTPUT) {
      say(c, ERROR, "the variable with the value reference %u cannot be set", (unsigned)r);
      c->now = before;
      return ERROR;
    }
    if (r >= FIRST_VALUE + N_INPUTS && before.mode != INSTANTIATED && before.mode != INITIALIZING &&
        c->now.values[r - FIRST_VALUE] != values[i]) {
      say(c, ERROR, "%s is a parameter: it can be set before the start only", value_names[r - FIRST_VALUE]);
      c->now = before;
      return ERROR;
    }
    has_changed = has_changed || c->now.values[r - FIRST_VALUE] != values[i];
    c->now.values[r - FIRST_VALUE] = values[i];
  }
  if (!has_changed) return OK;
  c->is_ahead_known = false;
  c->now.is_audited = false; /* another force, another energy */
  if (c->now.mode == INITIALIZING) c->now.has_start = false;
  if (c->now.mode > INITIALIZING && !values_are_legal(c)) {
    c->now = before;
    c->is_ahead_known = false;
    return ERROR;
  }
  return OK;
}

EXPORT Status FMI(fmi3GetFMUState)(Instance *c, void **state) {
  if (!*state) *state = malloc(sizeof(State));
  if (!*state) return ERROR;
  memcpy(*state, &c->now, sizeof(State));
  return OK;
}

EXPORT Status FMI(fmi3SetFMUState)(Instance *c, void *state) {
  if (!state) return ERROR;
  memcpy(&c->now, state, sizeof(State));
  c->is_ahead_known = false;
  return OK;
}

EXPORT Status FMI(fmi3FreeFMUState)(Instance *c, void **state) {
  (void)c;
  free(*state);
  *state = NULL;
  return OK;
}

EXPORT Status FMI(fmi3SerializedFMUStateSize)(Instance *c, void *state, size_t *size) {
  (void)c, (void)state;
  *size = sizeof(State);
  return OK;
}

EXPORT Status FMI(fmi3SerializeFMUState)(Instance *c, void *state, uint8_t bytes[], size_t size) {
  if (!state || size != sizeof(State)) {
    say(c, ERROR, "fmi3SerializeFMUState: %zu bytes are needed", sizeof(State));
    return ERROR;
  }
  memcpy(bytes, state, size);
  return OK;
}

EXPORT Status FMI(fmi3DeserializeFMUState)(Instance *c, const uint8_t bytes[], size_t size, void **state) {
  if (size != sizeof(State)) {
    say(c, ERROR, "fmi3DeserializeFMUState: these %zu bytes are no state of this FMU", size);
    return ERROR;
  }
  if (!*state) *state = malloc(sizeof(State));
  if (!*state) return ERROR;
  memcpy(*state, bytes, size);
  return OK;
}

/* Co-simulation. */

EXPORT Status FMI(fmi3EnterStepMode)(Instance *c) { return c->is_model_exchange ? ERROR : OK; }

EXPORT Status FMI(fmi3DoStep)(Instance *c, double t, double step, bool no_set_state, bool *event_needed,
                               bool *terminate, bool *early_return, double *last_time) {
  State before = c->now;
  Status status;
  (void)no_set_state;
  *event_needed = *terminate = *early_return = false;
  *last_time = c->now.t;
  if (c->is_model_exchange || c->now.mode != STEPPING) return ERROR;
  if (!(step > 0) || !is_finite(step) || !(fabs(t - c->now.t) <= 1e-9 * fmax(step, fabs(t)))) {
    say(c, ERROR, "fmi3DoStep from %.17g s by %.17g s: the FMU stands at %.17g s, and steps must be positive", t, step,
        c->now.t);
    return ERROR;
  }
  status = advance(c, t + step);
  if (status != OK) {
    c->now = before; /* as if the step had not been asked for */
    c->is_ahead_known = false;
  }
  *last_time = c->now.t;
  return status;
}

/* Model exchange. */

EXPORT Status FMI(fmi3EnterEventMode)(Instance *c) {
  c->now.mode = EVENT_MODE;
  return OK;
}

EXPORT Status FMI(fmi3EnterContinuousTimeMode)(Instance *c) {
  c->now.mode = CONTINUOUS_TIME;
  return OK;
}

EXPORT Status FMI(fmi3UpdateDiscreteStates)(Instance *c, bool *again, bool *terminate, bool *nominals, bool *values,
                                             bool *has_next, double *next) {
  double before[N_STATES];
  look_ahead(c);
  *again = *terminate = *nominals = *values = *has_next = false;
  *next = 0;
  memcpy(before, c->now.y, sizeof before);
  remember(c, c->now.t, before, c->now.y);
  if (N_CORRECTIONS) correct(c, c->now.t, c->now.y);
  *values = memcmp(before, c->now.y, sizeof before) != 0;
  return OK;
}

EXPORT Status FMI(fmi3CompletedIntegratorStep)(Instance *c, bool no_set_state, bool *enter_event, bool *terminate) {
  double t = c->now.t, v[N_VITALS], g[AT_LEAST_ONE(3 * N_CROSSINGS)];
  (void)no_set_state;
  *enter_event = *terminate = false;
  look_ahead(c);
  /* An importer that is coarse about events gets another chance before the audit. */
  if (N_CROSSINGS) {
    crossing_at(c, t, c->now.y, g);
    for (int i = 0; i < N_CONTACTS; i++) *enter_event |= g[2 * N_CROSSINGS + i] > 0 ? g[i] <= 0 : g[i] > 0;
  }
  if (*enter_event) return OK;
  if (!is_sound(c, t, c->now.y, false, ERROR)) return ERROR;
  if (N_CORRECTIONS) {
    AT(vitals, vitals_ahead_, c->now.y, v);
    *enter_event = v[VIOLATION] > 1e-3 * LARGEST_VIOLATION * DRIFT_SHARE || v[NORM] > DRIFT_SHARE * LARGEST_NORM;
  }
  return OK;
}

EXPORT Status FMI(fmi3SetTime)(Instance *c, double t) {
  if (!is_finite(t)) return ERROR;
  c->now.t = t;
  return OK;
}

EXPORT Status FMI(fmi3SetContinuousStates)(Instance *c, const double states[], size_t n) {
  if (n != N_STATES) return ERROR;
  if (!all_finite(states, N_STATES)) return DISCARD; /* the importer may try a smaller step */
  memcpy(c->now.y, states, sizeof c->now.y);
  return OK;
}

EXPORT Status FMI(fmi3GetContinuousStates)(Instance *c, double states[], size_t n) {
  if (n != N_STATES) return ERROR;
  memcpy(states, c->now.y, sizeof c->now.y);
  return OK;
}

EXPORT Status FMI(fmi3GetContinuousStateDerivatives)(Instance *c, double rates[], size_t n) {
  if (n != N_STATES) return ERROR;
  look_ahead(c);
  rate_at(c, c->now.t, c->now.y, rates);
  if (all_finite(rates, N_STATES)) return OK;
  say(c, DISCARD, "at t = %.9g s: the accelerations are not finite", c->now.t);
  return DISCARD;
}

EXPORT Status FMI(fmi3GetEventIndicators)(Instance *c, double out[], size_t n) {
  if (n != N_CROSSINGS) return ERROR;
  look_ahead(c);
  indicators_at(c, out);
  return OK;
}

EXPORT Status FMI(fmi3GetNominalsOfContinuousStates)(Instance *c, double out[], size_t n) {
  (void)c;
  if (n != N_STATES) return ERROR;
  for (int i = 0; i < N_STATES; i++) out[i] = nominal[i];
  return OK;
}

EXPORT Status FMI(fmi3GetNumberOfEventIndicators)(Instance *c, size_t *n) {
  (void)c;
  *n = N_CROSSINGS;
  return OK;
}

EXPORT Status FMI(fmi3GetNumberOfContinuousStates)(Instance *c, size_t *n) {
  (void)c;
  *n = N_STATES;
  return OK;
}

EXPORT Status FMI(fmi3EvaluateDiscreteStates)(Instance *c) {
  (void)c;
  return OK;
}

EXPORT Status FMI(fmi3EnterConfigurationMode)(Instance *c) {
  (void)c;
  return OK;
}

EXPORT Status FMI(fmi3ExitConfigurationMode)(Instance *c) {
  (void)c;
  return OK;
}

/* The standard asks for all its functions; those that have nothing to work on here say so. */

static Status not_here(Instance *c, const char *name) {
  say(c, ERROR, "%s: this FMU has no such variables or derivatives", name);
  return ERROR;
}

#define NOT_HERE(name) \
  EXPORT Status FMI(name)(Instance * c) { return not_here(c, #name); }

#define NO_TYPE(type) NOT_HERE(fmi3Get##type) NOT_HERE(fmi3Set##type)

NO_TYPE(Float32)
NO_TYPE(Int8)
NO_TYPE(UInt8)
NO_TYPE(Int16)
NO_TYPE(UInt16)
NO_TYPE(Int32)
NO_TYPE(UInt32)
NO_TYPE(Int64)
NO_TYPE(UInt64)
NO_TYPE(Boolean)
NO_TYPE(String)
NO_TYPE(Binary)
NO_TYPE(Clock)
NO_TYPE(IntervalDecimal)
NO_TYPE(IntervalFraction)
NO_TYPE(ShiftDecimal)
NO_TYPE(ShiftFraction)
NOT_HERE(fmi3GetNumberOfVariableDependencies)
NOT_HERE(fmi3GetVariableDependencies)
NOT_HERE(fmi3GetDirectionalDerivative)
NOT_HERE(fmi3GetAdjointDerivative)
NOT_HERE(fmi3GetOutputDerivatives)
NOT_HERE(fmi3ActivateModelPartition)
