"""Reports and pictures of a trial or an identification, and the figures in them."""
