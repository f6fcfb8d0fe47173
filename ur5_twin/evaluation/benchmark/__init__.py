"""The benchmark of estimators: scenarios x seeds x arms that differ from the one the estimators know.

``suite`` says what runs, ``arms`` and ``variation`` draw an arm and a scenario from a seed, ``preparation`` identifies
the arm as a user would, ``task`` runs one scenario and scores every estimator on it, ``executor`` runs many, ``store``
keeps what is done, ``leaderboard`` sums it up, ``run`` ties them together and ``report`` writes for people.
"""
