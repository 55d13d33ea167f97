/* Sorting and medians without own memory. */
#ifndef TRACTION_ORDER_STATISTICS_H
#define TRACTION_ORDER_STATISTICS_H

/* Two numbers, the smaller first. */
struct middle_pair {
    double below, above;
};

/* Sort n numbers, none of them NaN, in place, ascending. */
void sort_ascending(double *values, int n);

/* Median of n >= 1 numbers, which are sorted in place. */
double median_in_place(double *values, int n);

/* The two middle numbers (equal if their count is odd) of sorted numbers, of which one, `own`, is
 * left out; `others`, at least 1, is the number of those left. `own` NaN: none is left out. */
struct middle_pair middle_of_others(const double *sorted, int others, double own);

/* Numbers of one kind, ascending after they are sorted. */
struct ranking {
    double *numbers;
    int count;
};

/* Add a number, unless it is NaN. */
void ranking_add(struct ranking *ranking, double x);

/* Median of sorted numbers, of which one, `own`, is left out; for an even number the upper or the
 * lower of the middle two; NaN if there are none. If `own` is NaN, none is left out. */
double median_of_others(const struct ranking *ranking, double own, int upper);

#endif
