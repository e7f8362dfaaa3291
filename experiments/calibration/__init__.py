"""Calibration of the verdict: which limits and rules tell right registrations from wrong ones."""
