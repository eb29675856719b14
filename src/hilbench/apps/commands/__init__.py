"""The commands of the core itself: run, check, config, compile and others, as they are typed."""
