# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The one exception that users meet: its text is the single line they read."""


class InputError(Exception):
    """Something given from outside (a file, a parameter, an argument) cannot be used.

    The message is one line that says what is wrong and what would be right. Commands print it and
    exit with 1; the node logs it and refuses the transition.
    """
