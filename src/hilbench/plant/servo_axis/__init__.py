"""Servo axis: one shaft with inertia, friction and unbalance, driven by a servo drive; with load emulation."""
