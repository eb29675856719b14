"""What changes in a web line: the balance of a roller, the twin's tracking, detectors of what is not its modulus."""
