"""Study: altitude error over an approach, error against SINR, and the assumptions behind both."""
