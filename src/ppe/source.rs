//! Right-hand sides of the pressure equation.
//!
//! ISPH_DF (Cummins & Rudman 1999) asks for div v = 0 after the correction: div((1/rho) grad p) = div v* / dt.
//! Alone it lets small volume errors pile up. So a share gamma of the density-invariant source of Shao & Lo (2003)
//! is added, the relaxed condition of Asai et al. (2012):
//!
//! div((1/rho) grad p) = div v* / dt + gamma (1 - n / n_0) / dt^2
//!
//! with n the kernel sum and n_0 its value on the regular lattice. On the surface and within a neighbour of it a
//! kernel sum is small because it is cut off, not because the water expands: there only crowding (n > n_0)
//! counts. Surface rows carry no source at all, see [`surface`](crate::terms::surface).

/// Source of one row in 1/s2, with the sign of div((1/rho) grad p): `divergence` is div v* in 1/s, `crowding`
/// n / n_0 - 1, counted only where positive if `near_surface`.
pub fn divergence_free(divergence: f64, crowding: f64, near_surface: bool, gamma: f64, dt: f64) -> f64 {
    let crowding = if near_surface { crowding.max(0.0) } else { crowding };
    divergence / dt - gamma * crowding / (dt * dt)
}
