"""What flies: load, check, decide; no JAX on a UAV."""
