"""Leaders, their mirror image on the follower, and the session that ties both to the arbiter."""
