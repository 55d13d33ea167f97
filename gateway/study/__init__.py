"""Both papers, their rivals, evaluation: nobody on a bus needs a line of it."""
