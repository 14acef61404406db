"""A machine fitted to recordings of it: plan, campaign, model, likelihood, engine, doubt, results."""
