"""Estimation for a web line: momentum balance of a roller, span estimators, detectors of changes other than of E."""
