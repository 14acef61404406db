"""A machine fitted to recordings of it: campaign, plan, model, likelihood, engine, results."""
