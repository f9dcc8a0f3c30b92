#include "server/service/tracer.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <memory>
#include <thread>
#include <utility>

#include "oneapi/tbb/blocked_range.h"
#include "oneapi/tbb/parallel_for.h"

namespace deltaray {
namespace {

// How long the tracer waits for its threads to begin.
constexpr std::chrono::milliseconds kStartPatience{200};

uint32_t Cores() { return std::max(1u, std::thread::hardware_concurrency()); }

}  // namespace

Tracer::Tracer(uint32_t threads)
    : threads_(threads == 0 ? Cores() : threads),
      workers_(tbb::global_control::max_allowed_parallelism, std::max(threads_, Cores()) + 1),
      arena_(static_cast<int>(threads_), 0, tbb::task_arena::priority::high) {
  StartWorkers();
}

Tracer::~Tracer() { Stop(); }

void Tracer::StartWorkers() {
  // Each holds its thread until all have one. Of several tracers in a process, the later ones may get fewer.
  const auto begun = std::make_shared<std::atomic<uint32_t>>(0);
  const auto all_have_begun = [begun, deadline = std::chrono::steady_clock::now() + kStartPatience, this] {
    return *begun == threads_ || std::chrono::steady_clock::now() >= deadline;
  };
  for (uint32_t i = 0; i < threads_; ++i) {
    Enqueue([begun, all_have_begun] {
      ++*begun;
      while (!all_have_begun()) std::this_thread::yield();
    });
  }
  while (!all_have_begun()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

void Tracer::Enqueue(std::function<void()> task) {
  // Held by pointer, so that what the task holds is gone before Stop returns: TBB deletes the lambda some time later.
  auto held = std::make_shared<std::function<void()>>(std::move(task));
  {
    MutexLock lock(mutex_);
    if (stopped_) return;
    ++tasks_;
  }
  Submit([this, held] {
    (*held)();
    *held = nullptr;
    NoteEnd();
  });
}

void Tracer::EnqueueShort(std::function<void()> task) {
  {
    MutexLock lock(mutex_);
    if (stopped_) return;
    short_tasks_.push_back(std::move(task));
    ++short_task_count_;
    // Itself, and what makes sure that it is run where no task takes long.
    tasks_ += 2;
  }
  Submit([this] {
    RunShort();
    NoteEnd();
  });
}

template <typename Task>
void Tracer::Submit(Task task) {
  try {
    arena_.enqueue(std::move(task));
  } catch (...) {
    // For want of memory. Stop must not wait for it.
    NoteEnd();
    throw;
  }
}

void Tracer::RunShort() {
  thread_local bool running = false;
  if (running || short_task_count_.load(std::memory_order_relaxed) == 0) return;
  std::function<void()> task;
  {
    MutexLock lock(mutex_);
    if (short_tasks_.empty()) return;
    task = std::move(short_tasks_.front());
    short_tasks_.pop_front();
    --short_task_count_;
  }
  running = true;
  // While it waits for its own pieces, this thread takes up none of another batch, which may take long.
  tbb::this_task_arena::isolate(task);
  running = false;
  task = nullptr;
  NoteEnd();
}

void Tracer::NoteEnd() {
  MutexLock lock(mutex_);
  if (--tasks_ == 0) idle_.notify_all();
}

void Tracer::Stop() {
  MutexLock lock(mutex_);
  stopped_ = true;
  while (tasks_ != 0) idle_.wait(mutex_);
}

void Tracer::ForPieces(size_t size, size_t piece, const std::function<void(size_t, size_t)>& body) {
  if (size <= piece) {
    if (size != 0) body(0, size);
    return;
  }
  const size_t pieces = (size + piece - 1) / piece;
  tbb::parallel_for(
      tbb::blocked_range<size_t>(0, pieces, 1),
      [&](const tbb::blocked_range<size_t>& range) {
        for (size_t i = range.begin(); i != range.end(); ++i) body(i * piece, std::min(size, (i + 1) * piece));
      },
      tbb::simple_partitioner());
}

size_t Tracer::Concurrency() { return static_cast<size_t>(tbb::this_task_arena::max_concurrency()); }

}  // namespace deltaray
