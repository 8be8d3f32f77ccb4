"""Recalibration: its rules in virtual time, its process, and its doors."""
