"""Samplers: which point of a program's random choices to try next, given the results so far.

A campaign gets one from :func:`~taxinet_ros.samplers.registry.make_sampler`. All of them
work on quantiles of the program's own prior (:mod:`~taxinet_ros.samplers.space`), are
wrapped so that their sequence is independent of the number of workers
(:mod:`~taxinet_ros.samplers.sampler`), and report which points were drawn from the prior,
because rates are estimated from those alone (:mod:`taxinet_ros.trials.rates`).
"""
