"""Judging by marks on the floor: sparse places at known times, whole runs apart."""
