"""One shaft with inertia, friction and unbalance, turned by a servo drive; a load motor emulates what is not there."""
