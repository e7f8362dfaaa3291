"""The accuracy study: one real CT, radiographs simulated from it, rough starts."""
