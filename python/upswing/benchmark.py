"""A fixed benchmark: the same starts, plants and criteria for every planner and controller, and a table for a paper.

>>> benchmark = Benchmark(upswing.System.load("cart-pole"), samples=20)
>>> ours = benchmark.score("ours", upswing.Planner(benchmark.system))
>>> print(table([ours]))                                                    # doctest: +SKIP

The same on the command line: `upswing bench export` and `upswing bench score`. `realaigym` has the scores of another, published benchmark.
"""

from upswing._upswing import Benchmark, Score, realaigym
from upswing._upswing import score_table as table

__all__ = ["Benchmark", "Score", "realaigym", "table"]
