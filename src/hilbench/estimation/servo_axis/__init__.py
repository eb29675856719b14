"""Inertia and friction of a servo axis from its measured motion and torque."""
