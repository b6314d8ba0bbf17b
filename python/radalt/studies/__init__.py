"""The studies, one room each: points, measure and report of `evaluation.engine`. Nothing else imports them."""
