//! Cases of optics, volumes and shading.

pub(super) mod fresnel;
pub(super) mod furnace;
pub(super) mod nested_dielectrics;
pub(super) mod ray_marching;
pub(super) mod summation;
pub(super) mod terminator;
