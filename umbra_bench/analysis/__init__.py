"""What theory says of the methods, and the proofs and maps that need more than a sweep of steps.

- :mod:`oscillator`: the linear spring, where every method can be solved exactly;
- :mod:`backward_error`: what each method really integrates there, predicted and measured;
- :mod:`stability`: growth per step against omega dt;
- :mod:`symplectic`: the Jacobian of the step, by automatic differentiation;
- :mod:`identity`: how far two methods' positions are apart, in units of round-off;
- :mod:`rounding`: where float32 gives way, and how its error grows with time;
- :mod:`repair`: the two halves of the repair, each alone and both, and what they cost.
"""
