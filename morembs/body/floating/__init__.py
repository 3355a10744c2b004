"""The floating frame of reference: inertia integrals, frames, geometric stiffening."""
