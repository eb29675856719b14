"""What a machine is made of: the interface of a plant, effects, motors, sensors; one package a kind of machine."""
