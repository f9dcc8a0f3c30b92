// What was logged.

#ifndef TESTS_UNIT_SERVICE_CAPTURED_LOG_H_
#define TESTS_UNIT_SERVICE_CAPTURED_LOG_H_

#include <memory>
#include <sstream>
#include <string>

#include "server/service/log.h"
#include "spdlog/sinks/ostream_sink.h"
#include "spdlog/spdlog.h"

namespace deltaray {

// Has all that is logged while it lives at hand.
class CapturedLog {
 public:
  explicit CapturedLog(LogFormat format)
      : sink_(std::make_shared<spdlog::sinks::ostream_sink_mt>(stream_)), outer_(spdlog::default_logger()) {
    auto logger = std::make_shared<spdlog::logger>("test", sink_);
    logger->set_formatter(MakeLogFormatter(format));
    logger->set_level(spdlog::level::debug);
    spdlog::set_default_logger(logger);
  }
  ~CapturedLog() { spdlog::set_default_logger(outer_); }

  // REQUIRES: nobody logs any more.
  std::string text() const { return stream_.str(); }

 private:
  std::ostringstream stream_;
  const std::shared_ptr<spdlog::sinks::ostream_sink_mt> sink_;
  const std::shared_ptr<spdlog::logger> outer_;
};

}  // namespace deltaray

#endif  // TESTS_UNIT_SERVICE_CAPTURED_LOG_H_
