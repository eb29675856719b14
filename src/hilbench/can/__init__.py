"""The bus: frames, links, the embedded bus, wire timing and bus load."""
