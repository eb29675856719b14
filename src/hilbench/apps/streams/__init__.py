"""A run as it happens, for the tools that people have: MCAP files, Foxglove, PlotJuggler, MQTT."""
