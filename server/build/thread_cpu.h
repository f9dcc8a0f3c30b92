// The processor time of a thread.

#ifndef SERVER_BUILD_THREAD_CPU_H_
#define SERVER_BUILD_THREAD_CPU_H_

#include <time.h>

#include <cstdint>

namespace deltaray {

// What the calling thread has had of a processor so far.
inline int64_t ThreadCpuNanoseconds() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

}  // namespace deltaray

#endif  // SERVER_BUILD_THREAD_CPU_H_
