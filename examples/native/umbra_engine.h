/* The door through which umbra-bench drives an engine of yours: eight functions with C linkage in a
 * shared library. Build it, then:
 *
 *     umbra-bench simulate spring --method native:libtoy.so --dt 0.01
 *     umbra-bench identify native:libtoy.so
 *     umbra-bench gate --method native:libtoy.so --baseline baseline.json
 *
 * SI units; angles in rad, counter-clockwise. All numbers cross as double, whatever the engine keeps.
 * The library runs in a process of its own: if it crashes, the study says so and goes on.
 */
#ifndef UMBRA_ENGINE_H
#define UMBRA_ENGINE_H

#ifdef __cplusplus
extern "C" {
#endif

#define UMBRA_ABI 1

enum umbra_kind { UMBRA_DYNAMIC = 0, UMBRA_STATIC = 1, UMBRA_KINEMATIC = 2 };

struct umbra_body {
    double mass, inertia;      /* kg, kg m^2 */
    double x, y, angle;        /* m, m, rad */
    double vx, vy, omega;      /* m/s, m/s, rad/s */
    int kind;                  /* umbra_kind */
};

struct umbra_engine; /* yours */

/* UMBRA_ABI, as it was when the library was built. */
int umbra_abi(void);

/* How many bits the engine keeps of a number: 32 or 64. */
int umbra_precision(void);

/* A world with these bodies, at rest in time; NULL if the engine cannot hold one of them. */
struct umbra_engine *umbra_create(const struct umbra_body *bodies, int count);
void umbra_destroy(struct umbra_engine *engine);

/* Push a body at its centre and twist it, for the next step alone. */
void umbra_apply(struct umbra_engine *engine, int body, double fx, double fy, double torque);

/* Advance by dt seconds. No gravity and no damping of your own: both come as forces and velocities. */
void umbra_step(struct umbra_engine *engine, double dt);

/* Write x, y, angle, vx, vy, omega of one body. */
void umbra_read(const struct umbra_engine *engine, int body, double state[6]);

/* Replace a body's velocity (used where a scenario is damped). */
void umbra_set_velocity(struct umbra_engine *engine, int body, double vx, double vy, double omega);

#ifdef __cplusplus
}
#endif
#endif
