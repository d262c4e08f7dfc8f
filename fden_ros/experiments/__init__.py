"""The paper's experiments on anyone's data: dynamic, creep, nonlinearity, relaxation, indentation.

Each module derives its method; :func:`fden_ros.experiments.files.fit_file` reads CSV files, as
``fden fit`` does.
"""
