"""Commands of training: dataset, train, evaluate, camera."""
