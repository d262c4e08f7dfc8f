"""The pure core: from samples to classified tissue, one module per step, in data order.

``synchronize`` → ``contact`` → ``geometry`` → ``fractional_integral`` → ``estimator`` →
``classifier``, composed by ``pipeline``. ``model`` holds the constitutive law. Nothing here knows
ROS, a clock or a file.
"""
