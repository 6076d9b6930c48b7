"""Every situation in which an action is legal, or forbidden; and the action tried in it."""
