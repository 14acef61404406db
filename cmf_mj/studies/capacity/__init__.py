"""What the supply can carry: one manoeuvre judged, and the largest motion at each frequency."""
