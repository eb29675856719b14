"""Many runs of one config over values of its keys."""
