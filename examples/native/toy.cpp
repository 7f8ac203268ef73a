// A small engine behind the C interface: semi-implicit Euler, bodies in a vector. -DFAULT=1 builds it
// with positions advanced by the old velocity, so that a gate can be seen to turn red.

#include <vector>

#include "umbra_engine.h"

#ifndef FAULT
#define FAULT 0
#endif

namespace {

struct Body {
    umbra_body now;
    double inverse_mass, inverse_inertia;
    double fx = 0, fy = 0, torque = 0;
};

}  // namespace

struct umbra_engine {
    std::vector<Body> bodies;
};

extern "C" {

int umbra_abi(void) { return UMBRA_ABI; }

int umbra_precision(void) { return 64; }

umbra_engine *umbra_create(const umbra_body *bodies, int count) {
    auto *engine = new umbra_engine;
    for (int i = 0; i < count; ++i) {
        const bool moves = bodies[i].kind == UMBRA_DYNAMIC && bodies[i].mass > 0;
        const bool turns = moves && bodies[i].inertia > 0;
        engine->bodies.push_back({bodies[i], moves ? 1 / bodies[i].mass : 0,
                                  turns ? 1 / bodies[i].inertia : 0});
    }
    return engine;
}

void umbra_destroy(umbra_engine *engine) { delete engine; }

void umbra_apply(umbra_engine *engine, int body, double fx, double fy, double torque) {
    Body &b = engine->bodies[body];
    b.fx += fx;
    b.fy += fy;
    b.torque += torque;
}

void umbra_step(umbra_engine *engine, double dt) {
    for (Body &b : engine->bodies) {
        const umbra_body before = b.now;
        b.now.vx += b.fx * b.inverse_mass * dt;
        b.now.vy += b.fy * b.inverse_mass * dt;
        b.now.omega += b.torque * b.inverse_inertia * dt;
        const umbra_body &carried = FAULT ? before : b.now;
        b.now.x += carried.vx * dt;
        b.now.y += carried.vy * dt;
        b.now.angle += carried.omega * dt;
        b.fx = b.fy = b.torque = 0;
    }
}

void umbra_read(const umbra_engine *engine, int body, double state[6]) {
    const umbra_body &b = engine->bodies[body].now;
    state[0] = b.x, state[1] = b.y, state[2] = b.angle;
    state[3] = b.vx, state[4] = b.vy, state[5] = b.omega;
}

void umbra_set_velocity(umbra_engine *engine, int body, double vx, double vy, double omega) {
    umbra_body &b = engine->bodies[body].now;
    b.vx = vx, b.vy = vy, b.omega = omega;
}

}  // extern "C"
