"""Prediction of a web line's measurements: freely, or on measured motion; its drives' loops; a winding line."""
