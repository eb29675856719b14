"""CANopen: device runtime (slave side), master, PDO codec, EDS files."""
