"""Prediction of limit crossings: simulated futures from measurements, limits announced before they are crossed."""
