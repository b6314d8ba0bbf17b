"""Simulated propagation and front ends of two B210s."""
