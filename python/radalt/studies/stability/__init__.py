"""Study: every method and precision on stiff, extreme and broken frames, judged against float64."""
