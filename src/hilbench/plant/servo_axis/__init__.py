"""One shaft with inertia, friction and unbalance, turned by a servo drive; a load motor imitates what is not there."""
