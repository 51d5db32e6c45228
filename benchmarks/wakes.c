/* Wakes that are late by a period or more, counted as by cyclictest, where rt-tests is missing.
 *
 *     wakes PRIORITY CORE PERIOD_US SAMPLES
 *
 * It sleeps to absolute deadlines with clock_nanosleep, at SCHED_FIFO, on one core, with memory
 * locked. Passed deadlines are dropped. Prints the number of late wakes.
 */
#define _GNU_SOURCE
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>

#define NS_PER_S 1000000000LL

static int64_t now_ns(void)
{
	struct timespec now;
	clock_gettime(CLOCK_MONOTONIC, &now);
	return now.tv_sec * NS_PER_S + now.tv_nsec;
}

static void sleep_until_ns(int64_t deadline_ns)
{
	struct timespec deadline = { deadline_ns / NS_PER_S, deadline_ns % NS_PER_S };
	while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, NULL) != 0)
		;
}

static int take_rights(int priority, int core)
{
	struct sched_param param = { .sched_priority = priority };
	cpu_set_t cores;
	CPU_ZERO(&cores);
	CPU_SET(core, &cores);
	return mlockall(MCL_CURRENT | MCL_FUTURE) || sched_setaffinity(0, sizeof cores, &cores) ||
	       sched_setscheduler(0, SCHED_FIFO, &param);
}

int main(int count, char **words)
{
	if (count != 5)
		return fprintf(stderr, "usage: wakes PRIORITY CORE PERIOD_US SAMPLES\n"), 2;
	if (take_rights(atoi(words[1]), atoi(words[2])))
		return perror("wakes: memory lock, core or SCHED_FIFO refused"), 1;
	int64_t period_ns = 1000 * atoll(words[3]);
	int64_t deadline_ns = now_ns() + period_ns;
	long late = 0;
	for (long sample = atol(words[4]); sample > 0; sample--) {
		sleep_until_ns(deadline_ns);
		int64_t behind_ns = now_ns() - deadline_ns;
		late += behind_ns >= period_ns;
		deadline_ns += (behind_ns / period_ns + 1) * period_ns;
	}
	printf("%ld\n", late);
	return 0;
}
