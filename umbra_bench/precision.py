"""The one place where JAX's global state is touched, and only for as long as a block runs.

Truth is computed in float64 and UMBRA's own runs in float32, side by side. Both run inside
:func:`float64_allowed`, a context that leaves the caller's settings as they were: importing or using
this package changes no default of JAX.
"""

from __future__ import annotations

from contextlib import AbstractContextManager

import jax


def float64_allowed() -> AbstractContextManager[None]:
    """A context in which float64 arrays stay float64; float32 arrays stay float32."""
    return jax.enable_x64(True)
