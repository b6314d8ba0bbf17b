"""How well the altimeter decides per frame: against a textbook one, and where there is no return at all."""
