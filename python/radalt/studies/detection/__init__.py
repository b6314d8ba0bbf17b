"""Study: how well the altimeter decides frame by frame, beside a textbook altimeter and without a return."""
