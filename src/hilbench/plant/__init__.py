"""Plant models: interface, effects, motors, sensors; one package for each kind of machine."""
