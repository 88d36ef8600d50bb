"""Search of quadratic Lyapunov functions by conic programs."""

__all__ = []
