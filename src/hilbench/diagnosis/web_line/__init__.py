"""How what a web line measured is predicted: freely, or on measured motion; its drives' loops; a winding line."""
