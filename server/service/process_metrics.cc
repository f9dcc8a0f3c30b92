#include "server/service/process_metrics.h"

#include <sys/resource.h>
#include <sys/time.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <system_error>

#include "server/service/gauge_family.h"

namespace deltaray {
namespace {

// When this program was loaded, give or take.
const double kStarted = std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();

double Seconds(const timeval& time) {
  return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
}

// 0 where it cannot be had, as where no descriptor is left to read it by.
double ResidentBytes() {
  std::ifstream file("/proc/self/statm");
  double all_pages = 0, resident_pages = 0;
  file >> all_pages >> resident_pages;
  return resident_pages * static_cast<double>(sysconf(_SC_PAGESIZE));
}

double OpenFiles() {
  std::error_code error;
  double count = 0;
  for (std::filesystem::directory_iterator i("/proc/self/fd", error), end; !error && i != end; i.increment(error)) {
    ++count;
  }
  return count;
}

}  // namespace

std::vector<prometheus::MetricFamily> ProcessMetrics::Collect() const {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  rlimit files{};
  getrlimit(RLIMIT_NOFILE, &files);
  prometheus::MetricFamily cpu{
      "process_cpu_seconds_total", "Processor seconds, of user and system.", prometheus::MetricType::Counter, {{}}};
  cpu.metric[0].counter.value = Seconds(usage.ru_utime) + Seconds(usage.ru_stime);
  return {cpu, GaugeFamily("process_resident_memory_bytes", "Resident memory.", ResidentBytes()),
          GaugeFamily("process_open_fds", "Open file descriptors.", OpenFiles()),
          GaugeFamily("process_max_fds", "The most file descriptors that may be open.",
                      static_cast<double>(files.rlim_cur)),
          GaugeFamily("process_start_time_seconds", "When the process started, since 1970 UTC.", kStarted)};
}

}  // namespace deltaray
